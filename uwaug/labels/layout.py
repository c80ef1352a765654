"""Where trainers look for labels in folders, and the data.yaml that tells them where pictures are.

Ultralytics puts "labels" in place of the last folder "images" of a picture's path (its
`img2label_paths`). A picture without such a folder shows nothing to it, and it does not say so.
"""

import json
import re
from collections.abc import Iterable, Iterator
from hashlib import sha256
from pathlib import Path, PurePath, PurePosixPath
from typing import TypeVar

IMAGES, LABELS = "images", "labels"

DESCRIPTION = "data.yaml"
"""Name of the file that trainers are given."""

_SPLITS = ("train", "val", "test")

_OURS = (*_SPLITS, "path", "validation", "download")
"""Keys of a data.yaml that say where its pictures are."""

_SPLIT = re.compile(r"(train|val|test)(?:ing|id|idation)?(?:$|[^a-zA-Z])")

_KEY = re.compile(r"([A-Za-z_]\w*)\s*:")

_SIGNATURE = "# written by uwaug, which writes over it unless it is changed"
"""First line of a data.yaml, before the hash of the others."""

P = TypeVar("P", bound=PurePath)


def parted(place: PurePath) -> tuple[tuple[str, ...], tuple[str, ...]] | None:
    """What stands before and behind the last "images" of a file's folders; None without any."""
    folders = place.parts[:-1]
    if IMAGES not in folders:
        return None
    last = len(folders) - 1 - folders[::-1].index(IMAGES)
    return folders[:last], folders[last + 1 :]


def picture_place(place: P) -> P:
    """Where a picture with labels is written to, below the folder of a run: where it would be, but
    below "images" if no folder of it is called so.
    """
    return type(place)(IMAGES, place) if parted(place) is None else place


def label_place(place: P) -> P:
    """Where its label lies, with the picture's end."""
    folders = parted(place)
    if folders is None:
        return type(place)(LABELS, place)
    before, after = folders
    return type(place)(*before, LABELS, *after, place.name)


def splits_of(places: Iterable[str]) -> dict[str, list[str]]:
    """The folders of pictures by the split that they are of: train, val (or valid, validation) or
    test, as a folder below "images" or the one above it is called, digits aside; else train.
    Trainers take a folder with all below it.

    Raises:
        ValueError: if a folder with pictures of one split has those of another below it.
    """
    folders: dict[str, set[str]] = {}
    for place in places:
        parts = parted(PurePosixPath(place))
        if parts is None:
            continue
        before, after = parts
        named = [_SPLIT.match(name) for name in (*after[:1], *before[-1:])]
        split = next((match[1] for match in named if match), _SPLITS[0])
        folder = PurePosixPath(*before, IMAGES, *after[:1]).as_posix()
        folders.setdefault(split, set()).add(folder)
    splits = {folder: split for split, ours in folders.items() for folder in ours}
    for folder, split in splits.items():
        for above in map(str, PurePosixPath(folder).parents):
            if above in splits and splits[above] != split:
                got = f"has pictures right in it, and those of {split} below it in {folder}"
                cure = f"a trainer would learn from both: move them to {above}/train, say"
                raise ValueError(f"{above}: {got}: {cure}")
            if above in splits:
                folders[split].discard(folder)
    return {split: sorted(folders[split]) for split in _SPLITS if split in folders}


def description_of(labels: Path) -> Path | None:
    """The YAML file that names the classes of a folder of labels: beside the labels or above them;
    None if there is none, or several that might be meant.
    """
    above = [labels, labels.parent]
    if labels.parent.name.startswith((LABELS, *_SPLITS)):
        above.append(labels.parent.parent)  # of labels/train, and of train/labels
    for folder in above:
        files = [*folder.glob("*.yaml"), *folder.glob("*.yml")]
        naming = [file for file in sorted(files) if {"names", "nc"} & set(dict(_blocks(file)))]
        named = [file for file in naming if file.name == DESCRIPTION] or naming
        if named:
            return named[0] if len(named) == 1 else None
    return None


def has_keypoints(description: Path | None) -> bool:
    """Whether the YAML file of a data set says that its labels have keypoints."""
    return description is not None and "kpt_shape" in dict(_blocks(description))


def described(splits: dict[str, list[str]], before: Path | None, classes: list[str] | int) -> str:
    """The text of a data.yaml. Paths are from its own folder: it says none.

    Args:
        splits: folders of pictures, see `splits_of`.
        before: a data.yaml of the labels: all that it says, but where pictures are, is kept to the
            letter.
        classes: their names, or how many there are, where nothing else names them.
    """
    some = next(iter(splits.values()))
    lines = []
    for split in _SPLITS:
        if split not in splits and split == "test":
            continue
        if split not in splits:
            # trainers insist on both
            lines.append(f"# {split}: has no pictures of its own")
        folders = splits.get(split, some)
        where = folders if len(folders) > 1 else folders[0]
        # JSON is YAML, but for letters in two escapes
        lines.append(f"{split}: {json.dumps(where, ensure_ascii=False)}")
    if before is not None:
        lines += [block for key, block in _blocks(before) if key not in _OURS]
    elif isinstance(classes, int):
        lines.append(f"nc: {classes}")
    else:
        lines.append(f"names: {json.dumps(classes, ensure_ascii=False)}")
    text = "\n".join(lines) + "\n"
    return f"{_SIGNATURE}: {_hash_of(text)}\n{text}"


def is_as_described(file: Path) -> bool:
    """Whether a data.yaml is as a run has written it, and nobody has changed it since."""
    text = file.read_text(encoding="utf-8", errors="replace")
    first, _, rest = text.partition("\n")
    return first == f"{_SIGNATURE}: {_hash_of(rest)}"


def _hash_of(text: str) -> str:
    return sha256(text.encode("utf-8", "replace")).hexdigest()[:16]


def _blocks(file: Path) -> Iterator[tuple[str, str]]:
    """The keys of a YAML file, and the lines of each to the letter; none of what is no YAML of a
    key a line.
    """
    key, lines = "", list[str]()
    for line in file.read_text(encoding="utf-8-sig", errors="replace").splitlines():
        match = _KEY.match(line)
        if match is not None:
            if key:
                yield key, "\n".join(lines)
            key, lines = match[1], []
        if not line.startswith(("#", "---")):
            lines.append(line)
    if key:
        yield key, "\n".join(lines).rstrip()
