"""Labels of Pascal VOC: an XML file for each picture, and lists of the pictures of each split."""

from collections import defaultdict
from collections.abc import Collection, Iterator, Sequence
from os.path import splitext
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

from uwaug._support.atomic import read_text
from uwaug.files.labels import Folder, Key, require_size
from uwaug.files.paths import normal, split_of

if TYPE_CHECKING:
    from uwaug._support.pixels import Pixels, Size
    from uwaug.files.summary import Result

_LISTS = "ImageSets/Main"  # folder of the lists of each split, of names without an end


class Voc(Folder):
    """XML files with boxes, px, counted from 1; the last pixel is inside."""

    reads = "a folder of Pascal VOC's .xml"
    end = ".xml"
    folders = ("Annotations", "annotations")
    pictures = "JPEGImages"

    @staticmethod
    def require(file: Path) -> None:
        _read(file)

    def objects(self, name: str, size: "Size") -> Iterator["tuple[Key, Pixels]"]:
        from uwaug._support.pixels import of_box

        file = self.of[name]
        root = _read(file)
        stated = [float(root.findtext(f"size/{side}") or 0) for side in ("height", "width")]
        if all(stated):
            require_size(file, (round(stated[0]), round(stated[1])), size)
        for number, entry in enumerate(root.findall("object"), 1):
            ends = [entry.findtext(f"bndbox/{end}", "") for end in ["xmin", "ymin", "xmax", "ymax"]]
            try:
                x1, y1, x2, y2 = map(float, ends)
            except ValueError:
                place = f"{file}, object {number}"
                raise ValueError(f"{place}: bndbox must be four numbers, got {ends}") from None
            yield number, of_box(x1 - 1, y1 - 1, x2, y2, size)

    def without(self, dropped: Collection[Key], source: Path, place: str) -> bytes:
        root = _read(source)
        for number, entry in enumerate(root.findall("object"), 1):
            if number in dropped:
                root.remove(entry)
        for tag in ("filename", "path"):
            for entry in root.findall(tag):
                entry.text = place.rpartition("/")[2]
        return ElementTree.tostring(root, encoding="unicode").encode()

    def lists(self, pictures: Sequence["Result"]) -> tuple[dict[str, bytes], list[str]]:
        """The lists that lie above the labels, else one for each split. In the list of a class,
        pictures that have lost all its objects have none.
        """
        trees: dict[str, dict[str, list[str]]] = {}
        lost: set[tuple[str, str]] = set()
        for picture in pictures:
            above, place = self.parted(splitext(picture.place)[0])
            _, name = self.parted(splitext(picture.item.name)[0])
            trees.setdefault(above, defaultdict(list))[normal(name)].append(place)
            if any(not judged.kept for judged in picture.objects):
                entries = _read(self.of[picture.item.name]).findall("object")
                kept = [entries[int(j.key) - 1].findtext("name") for j in picture.objects if j.kept]
                names = {entry.findtext("name", "") for entry in entries}
                lost |= {(place, class_name) for class_name in names.difference(kept)}
        contents, notes = {}, []
        for tree, places in trees.items():
            folders = (folder / tree / _LISTS for folder in (self.path, self.path.parent))
            files = [file for folder in folders for file in sorted(folder.glob("*.txt"))]
            texts = {file.name: read_text(file) for file in files}
            lists = {name: text.splitlines() for name, text in texts.items()}
            for name in places if not lists else ():
                split = split_of(name.split("/")[:-1]) or "train"
                lists.setdefault(f"{split}.txt", []).append(name)
            for list_name, lines in lists.items():
                pairs = [_parted(normal(line.strip()), places) for line in lines]
                class_name = list_name.rpartition("_")[0]
                text = "".join(
                    f"{place}{' -1' if sign and (place, class_name) in lost else sign}\n"
                    for name, sign in pairs
                    for place in places.get(name, ())
                )
                if not text:
                    notes.append(f"no picture is in the list {list_name}")
                contents["/".join(filter(None, (tree, _LISTS, list_name)))] = text.encode()
        return contents, notes


def _parted(line: str, names: Collection[str]) -> tuple[str, str]:
    """Name in a line of a list, and the sign after it in the list of a class: 1, 0, -1 (absent)."""
    name, _, sign = line.rpartition(" ")
    is_whole = line in names or sign not in ("1", "0", "-1")
    name = line if is_whole else name.rstrip()
    return name, line.removeprefix(name)


def _read(file: Path) -> ElementTree.Element:
    try:
        root = ElementTree.parse(file).getroot()
    except ElementTree.ParseError as error:
        raise ValueError(f"{file}: is no XML file: {error}") from None
    if root.tag != "annotation":
        raise ValueError(f"{file}: expected an annotation of Pascal VOC, got {root.tag}")
    return root
