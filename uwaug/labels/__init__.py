"""Labels beside pictures that say how much can still be seen of each object: COCO, YOLO, masks.

    source = open_labels("instances.json")  # COCO; or a folder of YOLO's .txt, or of masks
    labels = source.labels_of("reef/0001.jpg")
    record = with_contrast(labels, contrast_map, min_contrast=0.05)
    labels.write(record, out / "labels/reef/0001_v0.png")  # YOLO, masks: 2 files
    record["output"] = "reef/0001_v0.png"
    source.write_run(records, out)  # COCO: one file for all; YOLO: data.yaml

`contrast_map` is what `uwaug.contrast` returns for the picture. An object's contrast is the mean of
it over the object's pixels: its mask or polygon, or all that its box touches. It is 0 where no
pixel of an object is in the picture.

Call all of them for every format: what a format has no use for returns no files. A record is as
JSON reads it back, so a run that goes on after a stop may read records from its sidecars.
`write_run` takes them in any order, one for each picture that was written. README.md in this folder
has the rest.
"""

from uwaug.labels.coco import CocoLabels
from uwaug.labels.folders import MaskLabels, YoloLabels
from uwaug.labels.source import (
    Labels,
    LabelSource,
    Object,
    label_paths,
    open_labels,
    with_contrast,
)

__all__ = [
    "CocoLabels",
    "LabelSource",
    "Labels",
    "MaskLabels",
    "Object",
    "YoloLabels",
    "label_paths",
    "open_labels",
    "with_contrast",
]
