"""Labels of YOLO: a text file for each picture, a data.yaml for all."""

import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Self

from uwaug._support.atomic import read_text
from uwaug.files.labels import Entry, Folder, Key, Labels
from uwaug.files.paths import PICTURES, Files, matched, normal, parts_of, split_of

if TYPE_CHECKING:
    from uwaug._support.pixels import Pixels, Size
    from uwaug.files.items import Item
    from uwaug.files.summary import Result

_CLASS_FILES = ("classes.txt", "obj.names", "_darknet.labels")  # with a class in each line
_LISTS = ("train.txt", "valid.txt", "val.txt", "test.txt")
_PLACE_KEYS = ("train", "val", "validation", "test", "path", "download")  # of a data.yaml


@dataclass(frozen=True, eq=False)
class Yolo(Folder):
    """Text files with one object a line.

    A line is `class cx cy w h`, with or without a confidence, or `class x1 y1 x2 y2 x3 y3 …` for a
    polygon. All but the class are shares of the picture's width or height. Where the data.yaml has
    `kpt_shape`, keypoints follow the box.
    """

    description: Entry = field(default_factory=dict)  # content of the data.yaml
    told: Sequence[str] = ()  # sentences on where classes are from
    dry_val: list[str] = field(default_factory=list)  # paths of what the description names as val
    # those of each picture that the description names
    splits: Mapping[str, list[str]] = field(default_factory=dict)

    reads = "a folder of YOLO's .txt"
    end = ".txt"

    @classmethod
    def opened(cls, path: Path, items: Sequence["Item"]) -> "Labels | str":
        labels = super().opened(path, items)
        return labels._with_splits(items) if isinstance(labels, Yolo) else labels

    @staticmethod
    def require(file: Path) -> None:
        try:
            _first(file)
        except ValueError as error:
            others = "DOTA, KITTI, MOT and VisDrone are written otherwise: convert them"
            raise ValueError(f"{file}: {error}: expected class cx cy w h; {others}") from None

    def described(self, samples: Sequence[Path]) -> Self:
        """The labels with the content of data.yaml, beside them or above, or of another .yaml with
        names; and with names in a separate file.
        """
        folders = self.path, self.path.parent, self.path.parent.parent
        places = dict.fromkeys([*folders, *(file.parent for file in self.of.values())])
        files = [place / name for place in places for name in _CLASS_FILES]
        lists = {f: "\n".join(_lines(f)).rstrip().splitlines() for f in files if f.is_file()}
        source, names = next(iter(lists.items()), (None, []))
        classes: Entry = {"names": names} if names else {}
        for folder in folders:
            files = [*folder.glob("*.yaml"), *folder.glob("*.yml")]
            contents = {file: content for file in files if "names" in (content := _read(file))}
            if (own := folder / "data.yaml").is_file():
                contents = {own: _read(own)}
            if len(contents) > 1:
                raise ValueError(f"{folder}: more than one .yaml has names: call one data.yaml")
            for file, content in contents.items():
                classes, source = classes | content, file if "names" in content else source
                told, val = _told(source, classes, lists), _dry_val(folder, content)
                return replace(self, description=classes, told=told, dry_val=val)
        counts = {len(numbers) for file in samples if (numbers := _first(file))}
        if len(counts) == 1 and min(counts) > 6:
            got = f"{samples[0]}: objects of {min(counts)} numbers are polygons, or have keypoints"
            cure = "say kpt_shape: [how many, 2 or 3], or of polygons nothing but names"
            raise ValueError(f"{got}: {cure}, in {self.path / 'data.yaml'}")
        told = _told(source, classes, lists)
        for folder in folders:  # lists as Darknet has them
            files = [file for file in map(folder.joinpath, _LISTS) if file.is_file()]
            stated: Entry = {split_of([file.stem]) or "": file.name for file in files}
            if stated.keys() - {"train"}:
                return replace(self, description=classes | stated, told=told)
        return replace(self, description=classes, told=told)

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

    def without(self, dropped: Collection[Key], source: Path, place: str) -> bytes:
        lines = {number: self._words(line) for number, line in enumerate(_lines(source), 1)}
        if not dropped and list(lines.values()) == list(map(str.split, _lines(source))):
            return source.read_bytes()
        rest = (" ".join(words) for number, words in lines.items() if number not in dropped)
        return "".join(f"{line}\n" for line in rest).encode()

    def _places(self, split: str) -> tuple[list[str], list[str]]:
        """Lines of the lists that data.yaml names for a split, and folders that it names."""
        stated = self.description.get(split) or []
        lines, folders = [], []
        for place in map(str, [stated] if isinstance(stated, str) else stated):
            above = (self.path, self.path.parent, self.path.parent.parent)
            files = filter(None, (Files().below(folder, place) for folder in above))
            if place.endswith(".txt"):
                lines += next((_lines(file) for file in files), [place])
            else:
                folders.append(place)
        return [line.strip() for line in lines if line.strip()], folders

    def _with_splits(self, items: Sequence["Item"]) -> Self:
        """The labels with the splits that the description names. Refuses a list without a line of
        any picture, where pictures are of no split: all would be in train, and val the same.
        """
        places = {split: self._places(split) for split in ("train", "val", "test")}
        pairs = [(split, line) for split, (lines, _) in places.items() for line in lines]
        numbers = matched([line for _, line in pairs], [item.picture for item in items])
        paths = {item.name: f"{normal(item.picture.absolute().as_posix())}/" for item in items}
        text, ends = "\n".join(paths.values()), []
        for split, (_, folders) in places.items():
            for parts in (parts_of(normal(folder)) for folder in folders):
                wholes = [
                    parts[i:] for i in range(len(parts)) if not i or {*parts[i:]} - {*PICTURES}
                ]
                ends += [(split, e) for w in wholes if (e := f"/{'/'.join(w)}/") in text][:1]
        splits = {}
        for name, picture, _ in items:
            # the inner folder counts, as a data set may lie in a folder called train
            starts = [(paths[name].rfind(end), split) for split, end in ends if end in paths[name]]
            inner = [split for start, split in starts if start == max(starts)[0]]
            splits[name] = [pairs[number][0] for number in numbers.get(picture, ())] or inner
        rest = [n for n, s in splits.items() if not s and not split_of(self.place(n).split("/"))]
        for split, (lines, _) in places.items():
            if lines and rest and not any(split in stated for stated in splits.values()):
                got = f"{lines[0]}, of the list of {split}, is the end of no picture's path"
                raise ValueError(f"{self.path}: {got}, such as {paths[rest[0]][:-1]}")
        return replace(self, splits=splits)

    def only(self, name: str) -> Self:
        return replace(super().only(name), splits={})

    def lists(self, pictures: Sequence["Result"]) -> tuple[dict[str, bytes], list[str]]:
        """data.yaml, with the classes of the labels or their number, and a list of pictures for
        each split, as the folder of one split may hold another.
        """
        import yaml

        notes = [*self.told]
        splits, is_described = {"train": ""}, any(self.splits.values())
        for picture in pictures:
            stated = self.splits[picture.item.name]
            folders = [] if is_described else picture.place.split("/")[:-1]
            for split in dict.fromkeys(stated) or [split_of(folders) or ""]:
                splits[split] = f"{splits.get(split, '')}./{picture.place}\n"
        rest = splits.pop("", "")
        if not is_described:
            splits["train"] += rest
        elif rest:
            count, first = rest.count("\n"), rest.partition("\n")[0]
            notes.append(f"{count} pictures are of no split, and in no list, such as {first}")
        for split in ("train", *filter(self.description.get, ["test"])):
            if not splits.setdefault(split, ""):
                notes.append(f"no picture is of the split {split}: {split}.txt lists nothing")
        classes = {key: x for key, x in self.description.items() if key not in _PLACE_KEYS}
        if not {"names", "nc"} & classes.keys():
            names = {picture.item.name for picture in pictures} & self.of.keys()
            lines = (line.split() for name in names for line in _lines(self.of[name]))
            classes["nc"] = max((int(float(words[0])) for words in lines if words), default=0) + 1
            looked = f"data.yaml, {', '.join(_CLASS_FILES)}"
            notes.append(f"no names of classes were found ({looked}): nc: {classes['nc']}, counted")
        entries: Entry = {split: f"{split}.txt" for split in splits}
        if "val" not in splits:
            entries |= {"val": self.dry_val} if self.dry_val else {}
            cure = "data.yaml has no val: add a folder of dry pictures to validate on"
            notes.append(f"val is dry: {', '.join(self.dry_val)}" if self.dry_val else cure)
        entries |= classes
        lists = {f"{split}.txt": text.encode() for split, text in splits.items()}
        text = yaml.safe_dump(entries, sort_keys=False, allow_unicode=True)
        return {**lists, "data.yaml": text.encode()}, notes


def _dry_val(root: Path, description: Entry) -> list[str]:
    """Absolute paths of all that a description names as val; none if any of it is not there."""
    stated, folders = description.get("val") or [], (root / str(description.get("path", "")), root)
    places = map(str, [stated] if isinstance(stated, str) else stated)  # Roboflow's begin with ../
    tried = [[f / end for f in folders for end in (p, p.removeprefix("../"))] for p in places]
    paths = [next((os.path.abspath(p) for p in each if p.exists()), "") for each in tried]
    return paths if all(paths) else []


def _told(source: Path | None, classes: Entry, lists: Mapping[Path, list[str]]) -> list[str]:
    """A sentence on where classes are from, and on a list that names others."""
    names = classes.get("names", [])
    names = [*names.values()] if isinstance(names, dict) else names
    rest = "".join([f", not of {file}" for file, own in lists.items() if own != names][:1])
    return [f"classes are those of {source}{rest}"] if source else []


def _first(file: Path) -> list[float]:
    return [float(word) for word in read_text(file).strip().partition("\n")[0].split()]


def _read(file: Path) -> Entry:
    """Content of a .yaml; empty if it is no mapping, unless the file is a data.yaml."""
    import yaml

    try:
        content = yaml.safe_load(file.read_bytes()) or {}
        if not isinstance(content, dict):
            raise ValueError(f"expected names and values, got a {type(content).__name__}")
    except (yaml.YAMLError, ValueError) as error:
        if file.name != "data.yaml":
            return {}
        raise ValueError(f"{file}: is no YAML file: {error}") from None
    return content


def _lines(file: Path) -> list[str]:
    return read_text(file).splitlines()
