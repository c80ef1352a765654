"""Does a net that is trained on simulated pairs give back colours that are known?

    python -m benchmarks.evidence.restore --kit FOLDER                the table and its figure
    python -m benchmarks.evidence.restore --kit FOLDER --arms "all three" --nets 1
    python -m benchmarks.evidence.restore --kit FOLDER --answered NETS     keeps the nets, too

A small net learns to give back pictures in air which an arm has degraded. Three tests have a truth:

* *film*: AprilTags in green, murky water, whose squares are white and black;
* *buoys*: painted balls, whose colours are those of near frames;
* *rendered*: a reef and the motorcycle in three waters that no arm draws.

Errors are ΔE2000 after one gain: a frame's brings its white squares to a luminance of .8, that of a
ball or a scene to that of the truth. All arms have the same pictures, distances, order and steps.
The folder holds the kits `detector`, `evidence` and `depth`, with the half that chooses.
"""

import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import torch
from PIL import Image
from skimage.color import deltaE_ciede2000, rgb2lab
from torch import Tensor, nn
from torch.nn.functional import interpolate, l1_loss, pad

import uwaug
from benchmarks.depth.pairs import read
from benchmarks.evidence import sets
from benchmarks.evidence.arms import ARMS, DEFAULTS, SHOWN, degraded, ours, tensors, through_camera
from benchmarks.evidence.detector import module, parser
from benchmarks.evidence.markers import DICTIONARY
from benchmarks.evidence.net import compared, grey_world, keeper, resampled_units
from benchmarks.evidence.readers import SIZE
from benchmarks.evidence.tasks import Array, Pool, made_up
from benchmarks.figures.charts import FIGURES
from benchmarks.figures.reef import reef
from benchmarks.harness import save
from uwaug.distance import fill_unknown
from uwaug.formation import linear_to_srgb, srgb_to_linear
from uwaug.presets.scene import motorcycle

SIDE = 128  # px: of a square in training
SHORT_SIDES = (128, 288)  # px: of the pictures that squares are cut of
DRAWS = 2  # of each square
BATCH = 16
RATE = 4e-3
STEPS = 1200
WIDTHS = (8, 16, 32, 48, 64)
"""Chosen by rendered scenes in other waters (by hand and defaults, 600 steps): ΔE 10.6. With a
stretch as input 11.5; fusing picture, stretch and grey-world 11.1, which has 21.8 and 27.6 on the
film. Wider first layers and differences as a second loss gain nothing; 1200 steps gain .5.
"""
TRIALS = 300  # of `uwaug.like`
SHOWN_FRAMES = 5

PLAIN = uwaug.RandomDevelopment.PLAIN
MAPS = "with maps"
NO_GAMUT = {"development": uwaug.RandomDevelopment(gamut=0.0)}
DEEP = {"vertical_depth": (1.0, 20.0)}
NO_DEVELOPMENT = "no development"
CHANGES: dict[str, dict[str, Any]] = {
    NO_DEVELOPMENT: {"development": uwaug.RandomDevelopment(**PLAIN)},
    "gamut=0": NO_GAMUT,
    "color_matrix=1": {"water": uwaug.RandomWater(color_matrix=1.0)},
    "1 to 20 m deep": {"water": uwaug.RandomWater(**DEEP)},
    "all three": {"water": uwaug.RandomWater(color_matrix=1.0, **DEEP), **NO_GAMUT},
}
FIGURE = ("by hand", DEFAULTS, "uwaug.like")  # between a stretch and the truth
TABLE = ("by hand", "Li 2020", "SLURPP 2025", DEFAULTS, NO_DEVELOPMENT, "uwaug.like", MAPS)

PAINTS = np.array([(175, 8, 30), (191, 235, 100), (31, 114, 87)]) / 255
"""Medians of the red buoy in a grey pool, of the yellow one in the nearest frame, whose water tints
it a little, and of the green one by lamps.
"""

PAPER = np.array([0.8, 0.04])[:, None]
"""Luminance of white and of black."""

WATERS = ("reef", "harbour", "lake")
CONTRASTS = (0.2, 0.5)  # left at the median distance
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])

LOGS, VEILS = slice(3), slice(3, 6)  # of the maps that a net says

Restore = Callable[[Array], Array]
"""From a picture (HxWx3, uint8) to light (HxWx3, linear)."""


class Net(nn.Module):
    """Gives pictures back (Bx3xHxW, 0…1). One that inverts says the logarithm of the direct share,
    and veil, too (Bx6xHxW), and by these finds the scene; of others they are 0.
    """

    def __init__(self, inverts: bool) -> None:
        super().__init__()
        ends = [*zip((3, *WIDTHS), WIDTHS, strict=False)]
        self.down = nn.ModuleList(_layer(a, b, stride=1 + (a > 3)) for a, b in ends)
        self.all = _layer(2 * WIDTHS[-1], WIDTHS[-1], side=1)
        self.up = nn.ModuleList(_layer(a + b, a) for a, b in ends[:0:-1])
        self.last = nn.Conv2d(WIDTHS[0], 6 if inverts else 3, 1)
        self.inverts = inverts

    def forward(self, picture: Tensor) -> tuple[Tensor, Tensor]:
        """Restored, and maps."""
        levels = [picture]
        for layer in self.down:
            levels.append(layer(levels[-1]))
        inner = levels.pop()
        mean = inner.mean((2, 3), keepdim=True).expand_as(inner)
        inner = self.all(torch.cat([inner, mean], 1))
        for layer in self.up:
            outer = levels.pop()
            larger = interpolate(inner, outer.shape[2:], mode="bilinear")
            inner = layer(torch.cat([outer, larger], 1))
        answer = self.last(inner)
        if not self.inverts:
            return picture + answer, torch.zeros_like(answer).repeat(1, 2, 1, 1)
        direct, veil = answer[:, :3].clamp(-6, 2).exp(), answer[:, 3:]
        light = ((srgb_to_linear(picture) - veil) / direct).clamp(1e-4, 2)
        return linear_to_srgb(light), answer


def _layer(before: int, after: int, side: int = 3, stride: int = 1) -> nn.Module:
    convolution = nn.Conv2d(before, after, side, stride, side // 2)
    return nn.Sequential(convolution, nn.BatchNorm2d(after), nn.ReLU())


def pool_of(kits: Path) -> Pool:
    """Squares of photographs with distances: made up, or measured."""
    rng, images, distances = np.random.default_rng(0), [], []
    folders = kits / "evidence/land", kits / "detector/land/train/images"
    paths = [path for folder in folders for path in sorted(folder.glob("*.jpg"))]
    pairs: list[tuple[Any, Any]] = [(Image.open(path).convert("RGB"), None) for path in paths]
    pairs += [(Image.fromarray(pair.picture), np.exp(pair.log)) for pair in read(kits / "depth")]
    for picture, measured in pairs:
        shortest = min(picture.size)
        scale = (
            rng.integers(SHORT_SIDES[0], max(SIDE, min(SHORT_SIDES[1], shortest)) + 1) / shortest
        )
        size = [max(SIDE, round(scale * side)) for side in picture.size]
        image = next(tensors([np.array(picture.resize(size, Image.Resampling.BOX))]))
        if measured is None:
            distance = torch.from_numpy(made_up(image, rng))[None]
        else:
            nearest = cv2.resize(measured, size, interpolation=cv2.INTER_NEAREST)
            distance = fill_unknown(torch.from_numpy(nearest)[None])
        left, top = (int(rng.integers(0, side - SIDE + 1)) for side in size)
        images.append(image[:, top : top + SIDE, left : left + SIDE])
        distances.append(distance[:, top : top + SIDE, left : left + SIDE].float())
    return Pool(torch.stack(images), torch.stack(distances), torch.arange(len(images)))


def pairs_of(name: str, pool: Pool, shown: list[Array], seed: int) -> tuple[Tensor, Tensor, Tensor]:
    """Pictures of an arm through the camera (bytes), in air (0…1), and maps."""
    torch.manual_seed(seed)
    if name == MAPS:
        return mapped(pool, seed)
    if name in CHANGES:
        arm = ours(**CHANGES[name])
    else:
        arm = ARMS[name]() if name in ARMS else SHOWN[name](shown, pool, TRIALS)
    wet, places = degraded(arm, pool, DRAWS, seed)
    return wet, pool.images[places], torch.zeros(len(wet), 6, 1, 1)


def mapped(pool: Pool, seed: int) -> tuple[Tensor, Tensor, Tensor]:
    """The same of the defaults, with maps of direct share and veil as the camera shows them."""
    rng, augment = np.random.default_rng(seed), uwaug.RandomUnderwater()
    wet, maps = [], []
    for image, distance in [*zip(pool.images, pool.distances, strict=True)] * DRAWS:
        scenes = augment.scenes(image, distance, augment.make_params(image))
        truth = scenes.truth()
        assert truth is not None  # as p is 1
        light = torch.stack([truth.direct, truth.veil])
        arriving, veil = torch.einsum("ij,njhw->nihw", truth.gain, light)
        wet.append(through_camera(scenes.formed()[None], rng)[0])
        maps.append(torch.cat([arriving.clamp(min=1e-3).log(), veil]))
    return torch.stack(wet), pool.images.repeat(DRAWS, 1, 1, 1), torch.stack(maps)


def trained(pairs: Sequence[Tensor], inverts: bool, seed: int, steps: int = STEPS) -> Net:
    """A net after so many steps; weights, order and mirrors hang on the seed alone."""
    torch.manual_seed(seed)
    net = Net(inverts).to(memory_format=torch.channels_last)
    optimiser = torch.optim.AdamW(net.parameters(), RATE)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, RATE, steps)
    for _ in range(steps):
        picked = torch.randint(len(pairs[0]), (BATCH,))
        mirrored = [axis for axis in (2, 3) if torch.rand(()) < 0.5]
        wet, clean, maps = (values[picked].flip(mirrored) for values in pairs)
        restored, answer = net((wet / 255).contiguous(memory_format=torch.channels_last))
        loss = l1_loss(restored, clean)
        if inverts:  # a logarithm counts a tenth of a level
            logarithms, veils = (l1_loss(answer[:, of], maps[:, of]) for of in (LOGS, VEILS))
            loss = loss + 0.1 * logarithms + veils
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
    return net


def restorer(path: Path) -> Restore:
    """By a net that is kept."""
    weights = torch.load(path)
    net = Net(inverts=len(weights["last.bias"]) > 3).to(memory_format=torch.channels_last).eval()
    net.load_state_dict(weights)

    @torch.no_grad()
    def restore(picture: Array) -> Array:
        height, width = picture.shape[:2]
        whole = pad(next(tensors([picture]))[None], (0, -width % 16, 0, -height % 16), "reflect")
        return linear(net(whole)[0][0, :, :height, :width].permute(1, 2, 0).clamp(0, 1).numpy())

    return restore


def linear(srgb: Array) -> Array:
    """Light of a picture."""
    return srgb_to_linear(torch.from_numpy(srgb)).numpy()


def balanced(picture: Array) -> Array:
    """By grey-world."""
    light = linear(picture / 255)
    means = light.mean((0, 1))
    return np.asarray((light * means.mean() / np.maximum(means, 1e-3)).clip(0, 1))


def stretched(picture: Array) -> Array:
    """Each channel from its 1st to its 99th percentile."""
    low, high = np.percentile(picture, (1, 99), axis=(0, 1))
    return linear(((picture - low) / np.maximum(high - low, 1)).clip(0, 1))


BASELINES: dict[str, Restore] = {
    "as it is": lambda picture: linear(picture / 255),
    "blank": lambda picture: np.full(picture.shape, 0.2),
    "grey-world": balanced,
    "stretch": stretched,
}


class Item(NamedTuple):
    """Something whose colour is known, in one picture."""

    block: str
    near: float  # the larger, the nearer
    error: float
    contrast: float = np.nan


def apart(light: Array, truth: Array, gain: float) -> Array:
    """ΔE2000 of light (…x3) after a gain."""
    srgb = (linear_to_srgb(torch.from_numpy(np.asarray(x))).numpy() for x in (gain * light, truth))
    return np.asarray(deltaE_ciede2000(*map(rgb2lab, srgb)))


def of_tags(
    restore: Restore, block: str, frame: Array, tags: list[tuple[int, Array]]
) -> list[Item]:
    """Of the tags of a frame (HxWx3, uint8); their contrast is 1 less black by white."""
    light, colours, sides = restore(frame), [], []
    for name, quad in tags:
        # of eight squares a side the outer ones are paper
        pattern = np.pad(cv2.aruco.generateImageMarker(DICTIONARY, name, 6), 1, constant_values=255)
        corners = 8 * np.array([[1, 1], [7, 1], [7, 7], [1, 7]], np.float32)
        matrix = cv2.getPerspectiveTransform(quad.astype(np.float32), corners)
        upright = cv2.warpPerspective(light, matrix, (64, 64)).reshape(8, 8, 8, 8, 3)
        means = upright[:, 2:6, :, 2:6].mean((1, 3))
        colours.append([np.median(means[pattern == level], 0) for level in (255, 0)])
        sides.append(np.linalg.norm(quad - np.roll(quad, 1, 0), axis=1).mean())
    white, black = (np.array(colours) @ LUMINANCE).T
    truth = np.broadcast_to(PAPER, np.shape(colours))
    errors = apart(np.array(colours), truth, PAPER[0, 0] / max(white.mean(), 1e-4)).mean(1)
    contrasts = 1 - black / np.maximum(white, 1e-4)
    return [Item(block, *row) for row in zip(sides, errors, contrasts, strict=True)]


def of_buoys(restore: Restore, crops: sets.Crops) -> Iterator[Item]:
    """Of balls in the middles of crops; the clearer one is seen, the nearer it counts."""
    y, x = np.mgrid[:48, :48] - 23.5
    ball, around = np.hypot(y, x) < 8, np.hypot(y, x) > 19
    for picture, label, block in zip(crops.images, crops.labels, crops.blocks, strict=True):
        middle, truth = np.median(restore(picture)[ball], 0), linear(PAINTS[label])
        gain = truth @ LUMINANCE / max(middle @ LUMINANCE, 1e-4)
        near = np.abs(np.median(picture[ball], 0) - np.median(picture[around], 0)).max()
        yield Item(str(block), near, float(apart(middle, truth, gain)))


def of_scene(
    restore: Restore, block: str, picture: Array, air: Array, metres: Array
) -> Iterator[Item]:
    """Of the nearer and the farther half of the things in a scene."""
    restored, truth, solid = restore(picture), linear(air), np.isfinite(metres)
    gain = truth[solid].mean(0) @ LUMINANCE / (restored[solid].mean(0) @ LUMINANCE)
    errors, near = apart(restored, truth, gain), metres <= np.median(metres[solid])
    for nearness, half in ((1.0, near), (0.0, ~near)):
        yield Item(block, nearness, float(errors[half & solid].mean()))


def in_waters(
    scenes: list[tuple[str, Tensor, Tensor]],
) -> Iterator[tuple[str, Array, Array, Array]]:
    """Scenes in waters: block, picture (HxWx3, uint8), in air (0…1), metres. The camera meters, and
    is not that of any arm.
    """
    settings = product(scenes, WATERS, CONTRASTS)
    for index, ((name, image, metres), water, contrast) in enumerate(settings):
        augment = uwaug.RandomUnderwater(
            uwaug.RandomWater(water, contrast=contrast, camera="Sigma SDMerill (NPL)"),
            light=uwaug.RandomLight(share=0.0),
            development=uwaug.RandomDevelopment(**(PLAIN | {"metered": True, "gamut": 1.0})),
        )
        picture, air = (
            x.permute(1, 2, 0) for x in (augment.at(0, 0, index)(image, metres)[0], image)
        )
        levels = picture.mul(255).round().byte().numpy()
        yield f"{name}, {water}", levels, air.contiguous().numpy(), metres[0].numpy()


class Bench(NamedTuple):
    """Pictures with a truth."""

    frames: list[tuple[str, Array, list[tuple[int, Array]]]]  # block, pixels, tags with corners
    buoys: sets.Crops
    rendered: list[tuple[str, Array, Array, Array]]
    shown: list[Array]

    @classmethod
    def of(cls, kits: Path) -> "Bench":
        """Of the kits."""
        folder = kits / "detector"
        kit, groups = module(folder), json.loads((folder / "choose/groups.json").read_text())
        truth, samples = kit.tags("choose/tags", folder), kit.load("choose/tags", folder)
        shown = range(0, len(samples), len(samples) // SHOWN_FRAMES)[:SHOWN_FRAMES]
        frames = []
        for place, sample in enumerate(samples):
            scale = SIZE[0] / sample.image.shape[1]
            boards = [board for board in truth.get(sample.name, []) if not board["ignore"]]
            tags = [(board["id"], scale * np.array(board["corners"])) for board in boards]
            if tags and place not in shown:
                small = cv2.resize(sample.image, SIZE, interpolation=cv2.INTER_AREA)
                frames.append((groups["tags"][sample.name], small, tags))
        bundled = motorcycle()
        half = (x[:, ::2, ::2] for x in (bundled.image, fill_unknown(bundled.distance)))
        scenes = [("reef", *reef(288)[:2]), ("motorcycle", *half)]
        buoys = sets.load(kits / "evidence").crops["buoys"]
        return cls(frames, buoys, [*in_waters(scenes)], [samples[i].image for i in shown])

    def items(self, restore: Restore) -> dict[str, list[Item]]:
        """Of each test."""
        buoys, by = self.buoys, restore
        if restore is balanced:  # by the light of whole frames
            buoys, by = buoys._replace(images=grey_world(buoys)), BASELINES["as it is"]
        return {
            "film": [item for frame in self.frames for item in of_tags(restore, *frame)],
            "buoys": [*of_buoys(by, buoys)],
            "rendered": [item for scene in self.rendered for item in of_scene(restore, *scene)],
        }


COLUMNS: dict[str, tuple[str, str, bool]] = {
    "film, ΔE": ("film", "error", False),
    "film, contrast": ("film", "contrast", False),
    "film, contrast, small": ("film", "contrast", True),
    "buoys, ΔE": ("buoys", "error", False),
    "buoys, ΔE, faint": ("buoys", "error", True),
    "rendered, ΔE": ("rendered", "error", False),
    "rendered, ΔE, far": ("rendered", "error", True),
}
"""Test and number of each column; and whether the smallest third of tags, the faintest of balls or
the farther half of a scene alone counts.
"""


def table(
    items: Mapping[str, list[dict[str, list[Item]]]], test: str, number: str, far: bool
) -> dict[str, Any]:
    """Of each arm the mean of a number, and what it has more than the defaults."""
    first = items["as it is"][0][test]
    near = np.array([item.near for item in first])
    inside = near <= (np.quantile(near, 1 / 3) if far else np.inf)
    often = resampled_units([item.block for item in first])[:, inside]
    weights = np.concatenate([np.ones_like(often[:1]), often])
    weights /= np.maximum(weights.sum(1, keepdims=True), 1)
    scores = {}
    for arm, nets in items.items():
        values = [np.array([getattr(item, number) for item in net[test]])[inside] for net in nets]
        scores[arm] = np.stack([weights @ of_net for of_net in values])
    return compared(scores, DEFAULTS if DEFAULTS in scores else "as it is")


def main(
    kits: Path, arms: Sequence[str], nets: int, answered: Path | None = None
) -> dict[str, Any]:
    """Train, score, save, print and draw. Nets, and what they give back, are kept in `answered`."""
    torch.set_num_threads(1)
    bench, pool = Bench.of(kits), pool_of(kits)
    looked_at = bench.frames[0][1], bench.rendered[0][1]
    items = {name: [bench.items(restore)] for name, restore in BASELINES.items()}
    columns = [looked_at, [as_bytes(stretched(x)) for x in looked_at]]
    with keeper(answered) as folder:
        for seed, arm in product(range(nets), arms):
            path, kept = (folder / f"{arm}, {seed}.{ending}" for ending in ("pt", "net"))
            if not kept.exists():
                began = time.process_time()
                net = trained(pairs_of(arm, pool, bench.shown, seed), arm == MAPS, seed)
                torch.save(net.state_dict(), kept)
                print(f"{arm}, {seed}: {time.process_time() - began:.0f} s", flush=True)
            if not path.exists():
                restore = restorer(kept)
                torch.save((bench.items(restore), [as_bytes(restore(x)) for x in looked_at]), path)
            of_net, pictures = torch.load(path, weights_only=False)
            items.setdefault(arm, []).append(of_net)
            columns += [pictures] * (seed == 0 and arm in FIGURE)
    tables = {title: table(items, *of) for title, of in COLUMNS.items()}
    for title, rows in tables.items():
        print(title, *(f"{arm} {row['score']:.2f}" for arm, row in rows.items()), sep="; ")
    results = {"steps": STEPS, "pairs": DRAWS * len(pool.labels), "tables": tables}
    save("restore", results)
    truth = np.full_like(looked_at[0], 255), np.uint8(255 * bench.rendered[0][2])
    rows = [
        np.hstack([cv2.resize(of[row], size) for of in (*columns, truth)])
        for row, size in enumerate(((216, 162), (216, 144)))
    ]
    Image.fromarray(np.vstack(rows)).save(FIGURES / "restored.jpg", quality=88)
    return results


def as_bytes(light: Array) -> Array:
    """Light as bytes."""
    srgb = linear_to_srgb(torch.from_numpy(light)).numpy()
    return np.round(255 * srgb.clip(0, 1)).astype(np.uint8)


if __name__ == "__main__":
    flags = parser(__doc__, tuple(dict.fromkeys((*TABLE, *CHANGES))))
    flags.set_defaults(arms=TABLE, nets=3)
    given = flags.parse_args()
    main(given.kit, given.arms, given.nets, given.answered)
