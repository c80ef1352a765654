"""Labels of YOLO: a text file for each picture, a data.yaml for all."""

import os
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Self

from uwaug._support.atomic import read_text
from uwaug.files.labels import Entry, Key, PerPicture

if TYPE_CHECKING:
    from uwaug._support.pixels import Pixels, Size
    from uwaug.files.summary import Result
    from uwaug.files.table import Row

_DATA = "data.yaml"
_PLACE_KEYS = ("train", "val", "validation", "test", "path", "download")  # of a data.yaml


@dataclass(frozen=True, eq=False)
class Yolo(PerPicture):
    """Text files with one object a line.

    A line is `class cx cy w h`, with or without a confidence, or `class x1 y1 x2 y2 x3 y3 …` for a
    polygon. All but the class are shares of the picture's width or height. Where the data.yaml has
    `kpt_shape`, keypoints follow the box.
    """

    description: Entry = field(default_factory=dict)  # content of the data.yaml
    source: Path | None = None  # the data.yaml

    reads = "YOLO's files"
    endings = (".txt",)
    end = ".txt"

    @classmethod
    def opened(cls, rows: Sequence["Row"], classes: Path | None = None) -> Self:
        labels = cls.of_rows(rows)
        counts = {count for count in labels.sampled(_first_count) if count}
        root = Path(os.path.commonpath([os.path.abspath(f.parent) for f in labels.of.values()]))
        places = [folder / _DATA for folder in (root, *root.parents[:2])]
        source = classes or next(filter(Path.is_file, places), None)
        if source is None and len(counts) == 1 and min(counts) > 6:
            got = f"objects of {min(counts)} numbers are polygons, or have keypoints"
            cure = "give a data.yaml (--classes), of keypoints with kpt_shape: [how many, 2 or 3]"
            raise ValueError(f"{root}: {got}: {cure}")
        if source is None:
            return labels
        described = replace(labels, description=_read(source), source=source)
        described._require_apart(rows)
        return described

    def _require_apart(self, rows: Sequence["Row"]) -> None:
        """Refuse to train on pictures that the data.yaml names as val, but not as train, too."""
        named: dict[str, set[Path]] = {}
        for split in ("train", "val", "test"):
            places = self._stated(split)
            listed = [p.parent / line for p in places if p.is_file() for line in _lines(p) if line]
            named[split] = {Path(os.path.abspath(place)) for place in (*places, *listed)}
        for row in rows:
            picture, split = Path(os.path.abspath(row.picture)), row.split or "train"
            own = {picture, *picture.parents}
            if split != "val" and own & named["val"] and not own & named[split]:
                got = f"{row.name} is of val there, but of {split} here"
                raise ValueError(f"{self.source}: {got}: write a table with the column split")

    def _stated(self, split: str) -> list[Path]:
        """Folders and lists that the data.yaml names for a split, there or not."""
        assert self.source is not None
        stated, root = self.description.get(split) or [], self.source.parent
        folders = root / str(self.description.get("path", "")), root
        paths = []
        for place in map(str, [stated] if isinstance(stated, str) else stated):
            # Roboflow's begin with ../
            tried = [f / end for f in folders for end in (place, place.removeprefix("../"))]
            path = next((path for path in tried if path.exists()), tried[0])
            paths.append(Path(os.path.abspath(path)))
        return paths

    def objects(self, name: str, size: "Size") -> Iterator["tuple[Key, Pixels]"]:
        from uwaug._support.pixels import of_box, of_polygons

        file = self.of[name]
        for number, line in enumerate(_lines(file), 1):
            if not line.strip():
                continue
            try:
                shares = [float(word) for word in self._words(line)[1:]]
                shares = shares[:4] if "kpt_shape" in self.description else shares
                is_whole = len(shares) >= 4 and len(shares) % 2 == 0
                if not is_whole or not all(-0.5 <= share <= 1.5 for share in shares):
                    expected = "expected a class, and shares of width and height, 0…1"
                    raise ValueError(f"{expected}; keypoints need a kpt_shape in data.yaml")
            except ValueError as error:
                raise ValueError(f"{file}, line {number}: {error}") from error
            corners = [share * side for share, side in zip(shares, cycle(size[::-1]), strict=False)]
            if len(corners) == 4:
                x, y, width, height = corners
                box = x - width / 2, y - height / 2, x + width / 2, y + height / 2
                yield number, of_box(*box, size)
            else:
                yield number, of_polygons([corners], size)

    def _words(self, line: str) -> list[str]:
        """Words of an object without its confidence, which trainers refuse."""
        words, count = line.split(), 5
        if words and "kpt_shape" in self.description:
            points, numbers = self.description["kpt_shape"]
            count += points * numbers
            if len(words) not in (count, count + 1):
                expected = f"a class, a box and {points} keypoints of {numbers} numbers each"
                raise ValueError(f"expected {expected}, got {len(words)} numbers")
        has_confidence = len(words) == count + 1 and 0 <= float(words[-1]) <= 1
        return words[:count] if has_confidence else words

    def without(self, dropped: Collection[Key], source: Path) -> bytes:
        lines = {number: self._words(line) for number, line in enumerate(_lines(source), 1)}
        if not dropped and list(lines.values()) == list(map(str.split, _lines(source))):
            return source.read_bytes()
        rest = (" ".join(words) for number, words in lines.items() if number not in dropped)
        return "".join(f"{line}\n" for line in rest).encode()

    def lists(self, results: Sequence["Result"]) -> tuple[dict[str, bytes], list[str]]:
        """data.yaml, and a list of the pictures of each split, of which "" is of train."""
        import yaml

        splits: dict[str, str] = {"train": ""}
        for result in results:
            split = result.row.split or "train"
            splits[split] = f"{splits.get(split, '')}./{result.place}\n"
        description: Entry = {split: f"{split}.txt" for split in splits}
        notes = [] if splits["train"] else ["no picture is of the split train: train.txt is empty"]
        if "val" not in splits:
            paths = self._stated("val") if self.source else []
            dry = [*map(str, paths)] if all(map(Path.exists, paths)) else []
            description |= {"val": dry} if dry else {}
            cure = "data.yaml has no val: add a folder of dry pictures to validate on"
            notes.append(f"val is dry: {', '.join(dry)}" if dry else cure)
        description |= {x: y for x, y in self.description.items() if x not in _PLACE_KEYS}
        if self.source is not None:
            notes.append(f"classes are those of {self.source}")
        else:
            names = {result.row.name for result in results} & self.of.keys()
            lines = (line.split() for name in names for line in _lines(self.of[name]))
            count = max((int(float(words[0])) for words in lines if words), default=0) + 1
            description["names"] = {number: str(number) for number in range(count)}
            notes.append(f"no {_DATA}: classes are numbers; classes (--classes) names them")
        lists = {f"{split}.txt": text.encode() for split, text in splits.items()}
        text = yaml.safe_dump(description, sort_keys=False, allow_unicode=True)
        return {**lists, _DATA: text.encode()}, notes


def _read(file: Path) -> Entry:
    import yaml

    try:
        content = yaml.safe_load(read_text(file)) or {}
    except yaml.YAMLError as error:
        raise ValueError(f"{file}: is no YAML file: {error}") from None
    if not isinstance(content, dict) or "names" not in content:
        raise ValueError(f"{file}: has no names of classes, as a data.yaml has")
    return content


def _first_count(file: Path) -> int:
    """How many numbers the first line of a file has."""
    try:
        return len([float(word) for word in read_text(file).strip().partition("\n")[0].split()])
    except ValueError as error:
        raise ValueError(f"{file}: {error}: expected class cx cy w h, as YOLO has it") from None


def _lines(file: Path) -> list[str]:
    return read_text(file).splitlines()
