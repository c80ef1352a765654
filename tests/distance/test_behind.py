import math

import pytest
import torch
import uwaug.distance.behind
from torch import Tensor
from uwaug.distance.behind import filled_behind_rows
from uwaug.distance.sample import Scaling, to_metres

from uwaug import RandomUnderwater
from uwaug.distance.convert import fill_unknown

pytestmark = pytest.mark.filterwarnings("ignore:distance is unknown")


def desk() -> Tensor:
    """Something at 1 m before a wall at 3 m, in a map of 60×80."""
    z = torch.full((1, 60, 80), 3.0)
    z[:, 20:, 20:50] = 1.0
    return z


def test_the_shadow_of_an_edge_is_as_far_as_what_is_behind() -> None:
    z = desk()
    truth = z.clone()
    z[:, 10:, 50:62] = 0
    assert torch.equal(fill_unknown(z, behind=True), truth)
    assert (fill_unknown(z) != truth).sum() > 200


@pytest.mark.parametrize(("size", "gap"), [(4, 6), (8, 4), (8, 10), (12, 10)])
def test_a_hole_is_filled_from_its_own_rim(size: int, gap: int) -> None:
    """And not from that of a speck beside it, nor the speck from the shadow's."""
    z = torch.full((1, 100, 160), 10.0)
    z[:, 30:70, 40:80] = 1.0
    z[:, 30:70, 80:88] = 0
    speck = slice(48, 48 + size), slice(80 - gap - size, 80 - gap)
    z[:, *speck] = 0
    filled = fill_unknown(z, behind=True)
    assert filled[:, *speck].max() == 1
    assert filled[:, 30:70, 80:88].mean() > 9
    assert filled[:, 30:70, 84:88].min() > 7


@pytest.mark.parametrize("side", [0, 1])
def test_a_hole_within_a_thing_stays_in_it(side: int) -> None:
    z = desk()
    truth = z.clone()
    z[:, 30:45, 28:42] = math.nan
    if side:  # a frame without distances is no shadow either
        z = torch.full((1, 60, 80), 2.0)
        truth = z.clone()
        z[..., :5] = 0
        z[..., -3:, :] = 0
    torch.testing.assert_close(fill_unknown(z, behind=True), truth)


def test_specks_in_a_floor_keep_its_slope() -> None:
    z = (1 / torch.linspace(0.2, 0.8, 60))[None, :, None].expand(1, 60, 80).contiguous()
    specks = torch.rand(z.shape, generator=torch.Generator().manual_seed(0)) < 0.02
    error = fill_unknown(z.masked_fill(specks, 0), behind=True)[specks] / z[specks] - 1
    assert error.abs().max() < 0.15


def test_what_lies_beyond_the_range_is_not_pulled_to_the_foreground() -> None:
    z = desk()
    z[:, :20] = 0  # the wall, beyond the range, borders on the thing
    z[:, 20:, 60:] = 3 + torch.linspace(0, 2, 20)
    filled = fill_unknown(z, behind=True)
    assert filled[:, 5:12].min() > 4.5
    assert fill_unknown(z)[:, 5:12, 20:50].max() < 3
    assert filled.max() <= 5
    z[:, 20, 60] = 90.0  # a wild one at the hole's edge
    assert fill_unknown(z, behind=True)[:, 5:12, :40].max() <= 5


def test_open_water_is_behind_everything() -> None:
    z = desk()
    z[:, :, 56:] = math.inf
    z[:, 25:, 50:56] = 0
    assert fill_unknown(z, behind=True)[:, 25:, 50:56].isinf().all()


def test_a_batch_is_filled_map_by_map_with_gradients() -> None:
    z = torch.stack([desk(), desk() + 1]).double()
    z[:, :, 10:, 50:62] = math.nan
    one = torch.stack([fill_unknown(part, behind=True) for part in z])
    z.requires_grad_()
    both = fill_unknown(z, behind=True)
    assert torch.equal(both, one)
    (slope,) = torch.autograd.grad(both[:, :, 10:, 50:62].sum(), z)
    assert slope.sum() == pytest.approx(2 * 50 * 12)
    assert slope.isfinite().all()


@pytest.mark.parametrize("size", [(61, 83), (60, 80)])
def test_large_maps_are_filled_on_blocks(
    size: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    z = torch.full((1, *size), 3.0)
    z[:, 20:, 20:50] = 1.0
    truth = z.clone()
    z[:, 10:, 50:62] = 0

    def rows(start: int, stop: int) -> Tensor:
        return z[:, start:stop]

    whole = filled_behind_rows(rows, size)
    assert torch.equal(whole(0, size[0]), fill_unknown(z, behind=True))
    monkeypatch.setattr(uwaug.distance.behind, "_PIXELS", size[0] * size[1] // 9)
    blocks = filled_behind_rows(rows, size)
    parts = [blocks(start, min(start + 7, size[0])) for start in range(0, size[0], 7)]
    filled = torch.cat(parts, 1)
    assert (filled != truth).sum(2).max() <= 2  # within the block of the edge
    assert torch.equal(filled[..., 52:], truth[..., 52:])


def test_transforms_and_files_have_a_word_for_it() -> None:
    z = desk()
    truth = z.clone()
    z[:, 10:, 50:62] = 0
    assert torch.equal(to_metres(z, Scaling(0, 0, 1), "metric", "behind"), truth)
    image = torch.rand(3, 60, 80)
    behind, known = (RandomUnderwater("7C", unknown=word) for word in ("behind", "error"))
    record = known.make_params(image)
    expected = known.transform(image, truth, record)
    torch.testing.assert_close(behind.transform(image, z, record), expected)
