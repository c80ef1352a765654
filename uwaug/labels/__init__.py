"""Labels beside pictures that say how much can still be seen of each object.

    source = open_labels("instances.json")  # COCO; or a folder of YOLO's .txt, or of masks
    labels = source.labels_of("reef/0001.jpg", (480, 640))  # height and width of the picture
    record = with_contrast(labels, contrast_map, min_contrast=0.05)
    source.write_picture(labels, record, out / "labels/reef/0001_v0.png")  # YOLO, masks: 2 files
    record["output"] = "reef/0001_v0.png"
    source.write_run(records, out)  # COCO: one file for all

`contrast_map` is what `uwaug.contrast` returns for the picture. An
object's contrast is the mean of it over the object's pixels: its mask or polygon, or
all that its box touches. It is 0 where no pixel of an object is in the picture.

The label file of reef/1.jpg is reef/1.txt (or .png) in the folder of labels; of images/train/1.jpg
it may be train/1.txt too, or labels/train/1.txt; and 1.txt where the folder of labels has none in
folders.

Call all of them for every format: what a format has no use for returns no files. Labels pickle, and
a record is as JSON reads it back. So workers may degrade while one process holds the source (a COCO
file can be large), and a run that goes on after a stop may read records from its index. `write_run`
takes them in any order, one for each picture that was written; `record["output"]` is its path below
the output folder.

What becomes of an object with less than `min_contrast`:

| format | of each object | below `min_contrast` |
|---|---|---|
| COCO | `"contrast"` in its annotation | `"iscrowd": 1` |
| YOLO | `STEM.contrast.json` beside `STEM.txt`, by the line of the input | its line is left out |
| masks | `STEM.contrast.json` beside `STEM.png`, by value | its pixels get 255 (16 bit: 65535) |

COCO's evaluation ignores `iscrowd`; MMDetection trains with it as a region to ignore; Detectron2's
and torchvision's loaders, and Ultralytics' converter, leave it out. No `"ignore"` is written:
COCO's evaluation overwrites it, Detectron2 refuses the file, and MMDetection takes the object for
background. YOLO's files have no column for it and no regions to ignore: what is left out is
background there.
"""

from uwaug.labels.coco import CocoLabels
from uwaug.labels.masks import MaskLabels
from uwaug.labels.opening import open_labels
from uwaug.labels.source import Labels, LabelSource, Object, with_contrast
from uwaug.labels.yolo import YoloLabels

__all__ = [
    "CocoLabels",
    "LabelSource",
    "Labels",
    "MaskLabels",
    "Object",
    "YoloLabels",
    "open_labels",
    "with_contrast",
]
