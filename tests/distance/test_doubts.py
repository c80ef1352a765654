"""Maps that are no metres, of a scene with a slanted floor and a box before a wall."""

import pytest
import torch
from torch import Tensor

from uwaug._support.once import muted
from uwaug.distance import along_ray, doubts
from uwaug.distance.doubts import first_maps

H, W, FOCAL = 240, 320, 300.0


def scene() -> tuple[Tensor, Tensor]:
    """A picture (3xHxW) and distances (1xHxW, m)."""
    rows = (torch.arange(H) + 0.5 - H / 2)[:, None].expand(H, W) / FOCAL
    columns = (torch.arange(W) + 0.5 - W / 2).expand(H, W) / FOCAL
    depth = torch.full((H, W), 6.0)
    depth = torch.minimum(depth, torch.where(rows > 0, 1.2 / rows.clamp(min=1e-3), torch.inf))
    depth = torch.minimum(depth, torch.where(columns < 0, -1.5 / columns.clamp(max=-1e-3), 9.0))
    picture = 0.2 + 0.1 * depth[None].expand(3, H, W)
    for top, left, metres in ((90, 200, 2.5), (40, 100, 3.0), (150, 60, 1.8), (30, 260, 4.0)):
        depth[top : top + 60, left : left + 40] = metres
        picture = picture.clone()
        picture[:, top : top + 60, left : left + 40] = 0.9 - 0.1 * metres
    noise = torch.rand(3, H, W, generator=torch.Generator().manual_seed(0))
    return (picture + 0.05 * noise).clamp(0, 1), along_ray(depth, FOCAL)[None]


def crops(x: Tensor, count: int) -> list[Tensor]:
    """Parts of a picture or a map, each another one."""
    return [x[..., 4 * k :] for k in range(count)]


def unit(z: Tensor) -> Tensor:
    return (z - z.min()) / (z.max() - z.min())


def holed(z: Tensor) -> Tensor:
    return torch.where(torch.arange(H)[:, None] < 0.6 * H, torch.nan, z)


def sparse(z: Tensor) -> Tensor:
    specks = torch.rand(z.shape, generator=torch.Generator().manual_seed(0)) < 0.6
    return z.masked_fill(specks, torch.inf)


def of_16_bits(z: Tensor) -> Tensor:
    """A map that was stretched from 0 to 65535, read in mm."""
    z = (65535 * unit(z)).round()
    return torch.where(z == 65535, torch.nan, z / 1000)


def specked(z: Tensor) -> Tensor:
    return torch.where((torch.arange(W) % 20 == 0) & (z < 4), 20.0, z)


FALSE = {
    "disparity": (lambda z: 200 / z, "like disparity"),
    "inverse": (lambda z: unit(1 / z), "relative, 0…1"),
    "inverse of any scale": (lambda z: 3 + 40 * unit(1 / z), "like disparity"),
    "relative": (unit, "relative, 0…1"),
    "8 bits, cropped": (lambda z: (1 + (200 * unit(z)).round()) / 255, "relative, 0…1"),
    "standardised": (lambda z: (z - z.mean()) / z.std(), "standardised"),
    "mm": (lambda z: (100 * z).round(), "--unit mm"),
    "stretched": (of_16_bits, "span all that 16 bits hold"),
    "a number alone": (specked, "are 20, a gap away from all other values: if they are unknown"),
    "cm": (lambda z: 100 * z, "centimetres"),
    "km": (lambda z: z / 1000, "--unit 1000"),
    "holes": (holed, "60 % of the distances are unknown"),
    "aspect": (lambda z: z[..., :240], "of another aspect"),
    "turned": (lambda z: z.mT, "turned or cropped"),
    "size": (lambda z: z[..., ::2, ::2], "brought to the picture's size"),
    "scattered infinity": (sparse, "60 % of the distances are +inf, scattered"),
}


def test_true_maps_are_not_doubted() -> None:
    image, z = scene()
    water = torch.where(z > 5.9, torch.inf, z)
    plane = torch.full_like(z, 3.0)
    for picture, distance in ((image, z), (image, water), (image, plane), (0.5 + 0 * image, z)):
        assert doubts(distance, picture) == []
        assert doubts(distance.flip(-2), (255 * picture.flip(-2)).byte()) == []
    assert doubts(torch.full((1, 2, 5), torch.inf), image[:, :2, :5]) == []


@pytest.mark.parametrize("name", FALSE)
def test_each_falsification_is_named(name: str) -> None:
    falsified, said = FALSE[name]
    image, z = scene()
    several = 4 if said == "like disparity" else 1
    (sentence,) = doubts(crops(falsified(z), several), crops(image, several))
    assert said in sentence


def test_maps_of_a_run_are_judged_by_most_of_them() -> None:
    image, z = scene()
    maps, pictures = [z, *crops(200 / z, 3)], [image, *crops(image, 3)]
    (sentence,) = doubts(maps, pictures)
    assert "disparity" in sentence
    maps[1] = z[..., :300]
    pictures[1] = image[..., :300]
    assert doubts(maps, pictures) == []
    with pytest.raises(ValueError, match="4 maps but image is 2"):
        doubts(maps, pictures[:2])


def test_one_map_may_be_a_ramp_or_a_bowl_and_end_at_a_metre() -> None:
    image, z = scene()
    for distance in (torch.linspace(1, 6, H * W).reshape(1, H, W), 200 / z, z / z.max()):
        assert doubts(distance, image) == []


def test_a_map_that_comes_again_counts_once(nothing_is_said: None) -> None:
    image, z = scene()
    assert doubts([200 / z] * 8, [image] * 8) == []
    ramp = torch.linspace(1, 6, H * W).reshape(1, H, W)
    for k in range(40):
        first_maps.question(ramp, image.roll(k, -1))  # silent: a warning would be an error


def test_the_first_map_is_questioned_alone(nothing_is_said: None) -> None:
    image, z = scene()
    with muted():
        first_maps.question(unit(z), image)  # a trial, which does not count
    with pytest.warns(UserWarning, match="relative, 0…1") as said:
        first_maps.question(unit(z), image, stacklevel=1)
    assert said[0].filename == __file__
    first_maps.question(unit(z), image)


@pytest.mark.parametrize("count, looks", [(8, 8), (5, 32)])
def test_maps_are_questioned_as_a_run(count: int, looks: int, nothing_is_said: None) -> None:
    """The first eight; or the first 32, where maps come again."""
    image, z = scene()
    pairs = list(zip(crops(200 / z, count), crops(image, count), strict=True))
    *before, last = (pairs * 7)[:looks]
    for distance, picture in before:
        first_maps.question(distance, picture)
    with pytest.warns(UserWarning, match="like disparity"):
        first_maps.question(*last)
