"""Markers in other waters: nets that read the tags of a film under water, tested on boards in air.

    python -m benchmarks.evidence.wet_tags --kit FOLDER

Nets of `benchmarks.evidence.readers` see each tag of half of the film as it is and with draws of an
arm on top. Boards have the film's tags alone. At home is the half of the film that was not seen.
The other way, from boards in air to the film, is told by `benchmarks.evidence.markers`.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from benchmarks.evidence import readers
from benchmarks.evidence.arms import none
from benchmarks.evidence.detector import Scene, module, parser
from benchmarks.evidence.markers import film_of
from benchmarks.evidence.net import keeper, logits, trained
from benchmarks.evidence.tasks import Array, made_up
from benchmarks.evidence.waters import AS_THEY_ARE, HOME, ON_TOP, halves
from benchmarks.harness import save

DRAWS = 3  # of an arm on top of each tag
BOARDS = "boards in air"


def learnt_of(frames: Sequence[tuple[Array, list[readers.Tag]]]) -> list[Scene]:
    """Frames with squares around their tags."""
    scenes = []
    for picture, tags in frames:
        small, squares = map(torch.from_numpy, readers.seen(picture, tags))
        names = torch.tensor([tag.name for tag in tags])
        scenes.append(Scene(small.permute(2, 0, 1) / 255, squares, names))
    return scenes


def asked(arm: str, scenes: list[Scene], shown: list[Array], crops: Tensor, seed: int) -> Array:
    """The names that a net reads in crops (bytes). It has been trained on scenes."""
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    maps = [torch.from_numpy(made_up(x.image, rng)).float()[None] for x in scenes * DRAWS]
    dry, of_dry = readers.degraded(none, scenes, maps[: len(scenes)], seed)
    wet, of_wet = readers.degraded(ON_TOP[arm](shown), scenes * DRAWS, maps, seed + 1)
    pictures, names = torch.cat([dry, wet]), torch.cat([of_dry, of_wet])
    shape = readers.IDS, readers.STEPS, seed, readers.RATE, readers.PLACES
    return logits(trained(pictures, names, *shape, readers.turned), crops).argmax(1).numpy()


def main(folder: Path, arms: Sequence[str], nets: int, answered: Path | None) -> None:
    """Train, read, compare, print and save."""
    torch.set_num_threads(1)
    kit = module(folder)
    frames = [(picture, tags) for picture, tags in film_of(kit, folder) if tags]
    half_of = halves([tags[0].block for _, tags in frames])
    pairs = [*zip(frames, half_of, strict=True)]
    seen, unseen = ([frame for frame, half in pairs if half == which] for which in (0, 1))
    scenes, tags = learnt_of(seen), [tag for _, of in unseen for tag in of]
    names = {int(name) for scene in scenes for name in scene.classes}
    land = [sample.image for sample in kit.load("land/val", folder)]
    boards, maps = readers.scenes_of(kit, land, readers.OTHER)
    dry, of_dry = readers.degraded(none, boards, maps, readers.OTHER)
    places = np.repeat(range(len(boards)), [readers.VIEWS * len(x.classes) for x in boards])
    of_film = np.array([int(name) in names for name in of_dry])
    film = np.stack([crop for frame in unseen for crop in readers.crops_of(*frame)])
    crops = torch.cat([torch.from_numpy(film).permute(0, 3, 1, 2), dry[of_film]])
    truth = {HOME: np.array([t.name for t in tags]), BOARDS: of_dry.numpy()[of_film]}
    blocks = {
        HOME: [t.block for t in tags],
        BOARDS: [str(place % len(land)) for place in places[of_film]],
    }
    right: dict[str, dict[str, list[Array]]] = {HOME: {}, BOARDS: {}}
    with keeper(answered) as answers:
        for seed in range(nets):
            for arm in arms:
                path = answers / f"{arm}, {seed}.npy".replace("/", " ")
                if not path.exists():
                    np.save(path, asked(arm, scenes, land, crops, seed))
                for test, read in zip(truth, np.split(np.load(path), [len(tags)]), strict=True):
                    right[test].setdefault(arm, []).append(read == truth[test])
                shares = (f"{test} {right[test][arm][-1].mean():.3f}" for test in truth)
                print(f"{arm}, {seed}:", *shares, flush=True)
    tables = {
        test: readers.table(right[test], readers.weights_of(blocks[test]), AS_THEY_ARE)
        for test in truth
    }
    counts = {test: len(of_tags) for test, of_tags in truth.items()}
    save("wet_tags", {"nets": nets, "steps": readers.STEPS, "tags": counts, "tables": tables})


if __name__ == "__main__":
    given = parser(__doc__, [*ON_TOP]).parse_args()
    main(given.kit, given.arms, given.nets, given.answered)
