"""The options of `uwaug degrade`, and what each says of itself."""

from pathlib import Path
from typing import Annotated

import typer

from uwaug.cli.names import complete_preset, complete_water

Inputs = Annotated[
    list[Path] | None,
    typer.Argument(
        help="Pictures, folders of them, or lists: CSV or Parquet with a column input and, if they "
        "like, id, distance, output."
    ),
]
Out = Annotated[
    Path | None,
    typer.Option(help="Folder to write to, made if need be; or, of one picture, a file."),
]
Distance = Annotated[
    str | None,
    typer.Option(
        help="Distance of each pixel: a folder of files with the pictures' names, a pattern such "
        "as {stem}_depth.png, one file, or metres."
    ),
]
WaterType = Annotated[
    str | None,
    typer.Option(
        help="Jerlov type: I, IA, IB, II, III, 1C, 3C, 5C, 7C, 9C.", autocompletion=complete_water
    ),
]
PresetName = Annotated[
    str | None,
    typer.Option(help="A preset, or the path of a TOML file.", autocompletion=complete_preset),
]
FitFile = Annotated[Path | None, typer.Option(help="What uwaug fit has written.")]
Random = Annotated[bool, typer.Option("--random", help="A water of its own for each picture.")]
Options = Annotated[
    Path | None, typer.Option(help="TOML file of options of RandomUnderwater, such as waters.")
]
Visibility = Annotated[str | None, typer.Option(help="m, or a range such as 2:10.")]
Contrast = Annotated[
    str | None, typer.Option(help="Left at the median distance, 0…1, or a range such as .2:.6.")
]
Severity = Annotated[int | None, typer.Option(help="1 (mild) to 5: a contrast.")]
VerticalDepth = Annotated[
    str | None, typer.Option("--depth", help="Of the scene below the surface, m, or a range.")
]
Exposure = Annotated[str | None, typer.Option(help="auto, none, or a gain in stops.")]
Kind = Annotated[
    str, typer.Option(help="Of distance files: metric, relative, inverse or disparity.")
]
Unit = Annotated[
    str, typer.Option(help="Of distance files: m, cm, mm, um, or how many metres 1 stands for.")
]
Unknown = Annotated[
    str, typer.Option(help="What 0 and NaN get: error, fill, skip, far, or metres.")
]
Near = Annotated[str | None, typer.Option(help="m, of relative and inverse distances.")]
Far = Annotated[str | None, typer.Option(help="m, of relative and inverse distances.")]
Gamma = Annotated[str | None, typer.Option(help="Exponent, of relative distances.")]
Focal = Annotated[
    float | None, typer.Option(help="Focal length, px: for the blur, planar depth and disparity.")
]
Baseline = Annotated[float | None, typer.Option(help="m, between the cameras of a disparity.")]
Offset = Annotated[float, typer.Option(help="px, of the principal points of a disparity.")]
Planar = Annotated[
    bool, typer.Option("--planar", help="Files hold depth along the optical axis, not the ray.")
]
Network = Annotated[Path | None, typer.Option(help="Depth network (ONNX), in place of --distance.")]
Seed = Annotated[int, typer.Option(help="Of all that is random.")]
Variants = Annotated[int, typer.Option(help="Of each picture.")]
Format = Annotated[
    str | None, typer.Option("--format", help="Of what is written: png, jpg, webp, tif, npy.")
]
Workers = Annotated[int | None, typer.Option(help="Processes; by default one for each core.")]
Resume = Annotated[bool, typer.Option("--resume", help="Go on where the same command was stopped.")]
Force = Annotated[bool, typer.Option("--force", help="Write over what is there.")]
LabelFiles = Annotated[
    Path | None,
    typer.Option("--labels", help="COCO file, or folder of YOLO's .txt or of .png masks."),
]
MinContrast = Annotated[
    float | None, typer.Option(help="Labels of what keeps less, 0…1, are marked as ignored.")
]
Void = Annotated[int | None, typer.Option(help='Value of masks that means "ignored" already.')]
Terms = Annotated[
    bool,
    typer.Option("--keep-terms", help="Write the direct, forward and backscattered light too."),
]
DryRun = Annotated[
    bool, typer.Option("--dry-run", help="Say what would be read and written, and how long.")
]
Ray = Annotated[
    str | None,
    typer.Option(
        help="In place of processes: local (Ray is started on this machine), auto (its cluster), "
        "or host:port of a cluster."
    ),
]
InShards = Annotated[
    str | None,
    typer.Option(
        "--shards",
        help="In place of --out, with --ray: Parquet files with the pictures inside, in a folder, "
        "s3://…, gs://… or fsspec+NAME://…",
    ),
]
Sheet = Annotated[bool, typer.Option("--sheet", help="Draw some of the results on one sheet.")]
From = Annotated[
    Path | None, typer.Option("--from", help="A record: make its picture again, the same bytes.")
]
