import math

import pytest
import torch
from scenes import rand
from torch import Tensor

from uwaug.distance import fill_unknown
from uwaug.distance.fill import _membrane

NAN, INF = math.nan, math.inf


def slope(height: int, width: int) -> Tensor:
    """A plane of the scene that leans away: 2 to 8 m."""
    rows = torch.linspace(0.5, 0.2, height, dtype=torch.float64)[:, None]
    columns = torch.linspace(0.0, -0.075, width, dtype=torch.float64)
    return (1 / (rows + columns))[None]


def disc(height: int, width: int, radius: float) -> Tensor:
    """A round hole in the middle."""
    y, x = torch.arange(height)[:, None] - height / 2, torch.arange(width) - width / 2
    return torch.hypot(y, x)[None] < radius


def nearest(distance: Tensor) -> Tensor:
    """Every hole filled with the value of the nearest known pixel."""
    from scipy.ndimage import distance_transform_edt

    holes = distance.isnan().numpy()[0]
    _, (rows, columns) = distance_transform_edt(holes, return_indices=True)
    return distance[:, rows, columns]


def test_a_plane_is_continued_across_a_wide_hole() -> None:
    z = slope(240, 320)
    holed = z.masked_fill(disc(240, 320, 80.0), NAN)
    error = (fill_unknown(holed) / z - 1).abs()
    assert error.max() < 0.04
    assert error.max() < 0.1 * (nearest(holed) / z - 1).abs().max()


def test_thin_holes_keep_edges_sharp() -> None:
    z = torch.full((1, 30, 40), 2.0)
    z[..., 20:] = 6.0
    z[..., 16:24] = NAN
    z[:, 10:14, :10] = NAN
    filled = fill_unknown(z)
    assert filled.unique().tolist() == [2.0, 6.0]
    assert torch.equal(filled, nearest(z))


def exact(distance: Tensor) -> Tensor:
    """The membrane over 1/z: each unknown pixel is the mean of its neighbours."""
    known = ~distance.isnan()
    kernel = torch.tensor([[0, 1, 0], [1, 0, 1], [0, 1, 0]]).double()[None, None] / 4
    inverse = (1 / distance).where(known, 0.3)
    for _ in range(5000):
        wide = torch.nn.functional.pad(inverse, (1, 1, 1, 1), mode="replicate")
        inverse = inverse.where(known, torch.nn.functional.conv2d(wide, kernel))
    return 1 / inverse


@pytest.mark.parametrize("touching", [False, True], ids=["inside", "at the border"])
def test_is_nearly_the_membrane(touching: bool) -> None:
    coarse = 2 + 6 * rand(1, 1, 4, 5)
    z = torch.nn.functional.interpolate(coarse, (48, 60), mode="bicubic")[0].clamp(1, 9)
    hole = disc(48, 60, 16.0)
    if touching:
        hole = hole.roll(20, -1) & (torch.arange(60) > 20)
    inverse = (1 / z).masked_fill(hole, 0.0)
    membrane = exact(z.masked_fill(hole, NAN))
    error = 1 / _membrane(inverse[None], ~hole[None])[0] / membrane - 1
    assert error.abs().max() < 0.03
    assert error[hole].square().mean().sqrt() < 0.01


@pytest.mark.parametrize("size", [(1, 1), (1, 50), (50, 1), (33, 47)])
@pytest.mark.parametrize("share", [0.5, 0.99])
def test_stays_between_what_is_known(size: tuple[int, int], share: float) -> None:
    for seed in range(5):
        z = 1 + 9 * rand(1, *size, seed=seed)
        known = rand(1, *size, seed=seed + 100) >= share
        known[0, seed % size[0], seed % size[1]] = True
        filled = fill_unknown(z.masked_fill(~known, NAN))
        assert torch.equal(filled[known], z[known])
        least, largest = z[known].aminmax()
        assert filled.min() >= least * (1 - 1e-12)
        assert filled.max() <= largest * (1 + 1e-12)


def test_open_water_and_absurd_distances() -> None:
    hole = disc(40, 50, 15.0)
    z = torch.full((1, 40, 50), INF)
    assert fill_unknown(z.masked_fill(hole, NAN)).isinf().all()
    z[..., 25:] = 2.0
    filled = fill_unknown(z.masked_fill(hole, NAN))
    assert filled.min() >= 2 - 1e-6  # which NaN is not
    assert filled[0, 20, 25:].isfinite().all()
    for value in (1e-12, 1e30):
        assert (fill_unknown(torch.full((1, 40, 50), value).masked_fill(hole, NAN)) > 0).all()


def test_gradients() -> None:
    hole = disc(30, 30, 11.0)
    z = (1 + 5 * rand(1, 30, 30)).masked_fill(hole, NAN)
    lost = hole[:, 18:, 18:]

    def filled(corner: Tensor) -> Tensor:
        whole = z.clone()
        whole[:, 18:, 18:] = corner.masked_fill(lost, NAN)
        return fill_unknown(whole)[:, 10:20, 10:20]

    assert torch.autograd.gradcheck(filled, z[:, 18:, 18:].nan_to_num().requires_grad_())
    z[..., :4] = INF
    (slopes,) = torch.autograd.grad(fill_unknown(z.requires_grad_())[hole].sum(), z)
    assert slopes.isfinite().all()
    assert (slopes[hole] == 0).all()


def test_what_is_whole_is_returned_and_what_is_empty_refused() -> None:
    z = torch.tensor([[0.5, INF, 3.0]])
    assert fill_unknown(z) is z
    assert fill_unknown(torch.zeros(0, 1, 4, 4)).shape == (0, 1, 4, 4)
    maps = torch.ones(3, 1, 4, 5).index_fill(0, torch.tensor(2), NAN)
    with pytest.raises(ValueError, match="distance must have a known pixel in each map"):
        fill_unknown(maps)


def test_warns_once_where_much_is_guessed(nothing_is_said: None) -> None:
    z = torch.ones(2, 1, 10, 10)
    z[1, :, :2] = 0.0
    fill_unknown(z)  # 20 % is not yet much
    z[1, :, 2] = 0.0
    with pytest.warns(UserWarning, match="unknown at 30 % of a map, and guessed") as said:
        fill_unknown(z)
    fill_unknown(z)  # silent: a warning would be an error
    assert [warning.filename for warning in said] == [__file__]


# From behind


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


@pytest.mark.parametrize(
    "size, gap, wide", [(4, 6, 8), (8, 4, 8), (8, 10, 8), (12, 10, 8), (5, 3, 3)]
)
def test_a_hole_is_filled_from_its_own_rim(size: int, gap: int, wide: int) -> None:
    """And not from that of a speck beside it, nor the speck from the shadow's."""
    z = torch.full((1, 100, 160), 10.0)
    z[:, 30:70, 40:80] = 1.0
    z[:, 30:70, 80 : 80 + wide] = 0
    speck = slice(48, 48 + size), slice(80 - gap - size, 80 - gap)
    z[:, *speck] = 0
    filled = fill_unknown(z, behind=True)
    assert filled[:, *speck].max() == 1
    assert filled[:, 30:70, 80:88].mean() > 9
    assert filled[:, 30:70, 84:88].min() > 7


def test_a_hole_within_a_thing_stays_in_it() -> None:
    z = desk()
    framed = torch.full((1, 60, 80), 2.0)  # a frame without distances is no shadow either
    for truth, holes in (
        (z, [(slice(30, 45), slice(28, 42))]),
        (framed, [(slice(None), slice(5)), (slice(-3, None), slice(None))]),
    ):
        holed = truth.clone()
        for rows, columns in holes:
            holed[:, rows, columns] = NAN
        torch.testing.assert_close(fill_unknown(holed, behind=True), truth)


def test_specks_in_a_floor_keep_its_slope() -> None:
    z = (1 / torch.linspace(0.2, 0.8, 60))[None, :, None].expand(1, 60, 80).contiguous()
    specks = rand(1, 60, 80) < 0.02
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
