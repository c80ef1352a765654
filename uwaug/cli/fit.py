"""`uwaug fit`."""

import csv
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from uwaug.cli import distances
from uwaug.cli.choices import ColorSpace, Correction, FitModel, ForceFile, Gain, Surfaces, complete
from uwaug.cli.console import (
    cures_in_flags,
    fail,
    print_written,
    refuse,
    reported_errors,
    require_package,
    require_writable,
    status,
)

if TYPE_CHECKING:
    from torch import Tensor

    from uwaug.io import DistanceFormat


def fit(
    out: Annotated[Path, typer.Option(help="The JSON file to write.")],
    clean: Annotated[
        list[Path] | None,
        typer.Option(help="Picture of the scene without water. One serves all observed ones."),
    ] = None,
    observed: Annotated[
        list[Path] | None,
        typer.Option(
            help="Picture of the scene in the water. Repeat it, for several of one water."
        ),
    ] = None,
    distance: Annotated[
        list[str] | None,
        distances.flag(help=distances.FILE_HELP, metavar=distances.FILE),
    ] = None,
    series: Annotated[
        Path | None,
        typer.Option(
            help="In place of these three: a CSV of pictures at several turbidities, with the "
            "columns clean, observed, distance (paths from its folder) and turbidity."
        ),
    ] = None,
    waters: Annotated[
        bool,
        typer.Option(
            "--waters",
            help="Which Jerlov type, how far one sees in it, and how deep the scene lies, in place "
            "of coefficients: of pictures as uwaug degrade --water makes them.",
        ),
    ] = False,
    distance_kind: Annotated[
        Literal["metric", "disparity"],
        distances.flag(help="Of files: a fit needs metres."),
    ] = "metric",
    distance_unit: distances.Unit = "m",
    unknown: Annotated[
        str,
        distances.flag(
            help="What 0 and NaN get: skip (they do not count), far, or metres.",
            metavar="WORD|METRES",
            autocompletion=complete("skip", "far"),
        ),
    ] = "skip",
    planar: distances.Planar = False,
    focal_px: Annotated[
        float | None,
        distances.flag(
            help="Focal length, px of the picture: of planar depth and disparity; lets a fit try "
            "calibrated; with --waters, of the blur."
        ),
    ] = None,
    baseline: distances.Baseline = None,
    offset_px: distances.OffsetPx = 0.0,
    model: Annotated[FitModel, typer.Option(help="One model, or the best of all.")] = "auto",
    gain: Annotated[
        Gain | None,
        typer.Option(
            help="As the pictures tell (auto, the default); one exposure (fixed); one for each "
            "picture (free, the default with --waters); one for each colour (channels); with "
            "--waters, a colour matrix and a black for each picture (matrix)."
        ),
    ] = None,
    shading: Annotated[
        Correction | None,
        typer.Option(
            help="Corners or a side that are darker: fitted where the pictures tell of it (auto, "
            "the default), never (fixed) or always (free)."
        ),
    ] = None,
    tone: Annotated[
        Correction | None,
        typer.Option(help="A tone curve of the camera's own, as --shading."),
    ] = None,
    camera: Annotated[
        str | None,
        typer.Option(help="With --waters: a name or a CSV file. A wrong one gives a wrong water."),
    ] = None,
    surfaces: Annotated[
        Surfaces | None, typer.Option(help="With --waters: spectral by default.")
    ] = None,
    vertical_depth: Annotated[
        float | None,
        typer.Option(
            "--vertical-depth", "--depth", help="With --waters: m below the surface, if known."
        ),
    ] = None,
    color_space: Annotated[ColorSpace, typer.Option(help="Of the pictures.")] = "srgb",
    mask: Annotated[
        list[Path] | None, typer.Option(help="Pictures that are > 0 where pixels count.")
    ] = None,
    seed: Annotated[
        int, typer.Option(min=0, help="Of the pixels that are drawn, and of random starts.")
    ] = 0,
    report: Annotated[
        Path | None, typer.Option(help="A picture of the fit too: .png or .jpg.")
    ] = None,
    force: ForceFile = False,
) -> None:
    """Which water is it? Coefficients or a Jerlov type, and how sure they are."""
    pairs: dict[str, list[Any]] = {"clean": clean or [], "observed": observed or []}
    with reported_errors():
        pairs["distance"] = [distances.one_place(text) for text in distance or []]
        format = distances.format_of(
            distance_kind,
            distance_unit,
            unknown,
            planar=planar,
            focal_px=focal_px,
            baseline=baseline,
            offset_px=offset_px,
        )
    if unknown in ("fill", "behind", "error"):
        refuse(f"--unknown {unknown}: expected skip, far or metres: a fit counts what is measured")
    named = {"camera": camera, "surfaces": surfaces, "vertical_depth": vertical_depth}
    of_waters: dict[str, Any] = {name: x for name, x in named.items() if x is not None}
    if waters and (series is not None or model != "auto"):
        refuse("--waters takes the place of --model and --series: give one of them")
    camera_named = {"gain": gain, "shading": shading, "tone": tone}
    of_camera = {name: x for name, x in camera_named.items() if x is not None}
    if waters and (of_camera.keys() - {"gain"}):
        refuse("--shading and --tone are for coefficients: expected neither beside --waters")
    if of_waters and not waters:
        refuse("--camera, --surfaces and --vertical-depth are for --waters: give it too")
    # planar depth and disparity of a series need a focal length
    idle_focal_px = focal_px is not None and not planar and distance_kind == "metric"
    if series is not None and (any(pairs.values()) or of_camera or idle_focal_px):
        flags = "--clean, --observed, --distance, --gain, --shading, --tone or --focal-px"
        refuse(f"--series takes the place of pairs of one water: expected no {flags} beside it")
    if series is None and not all(pairs.values()):
        refuse("a fit needs --clean, --observed and --distance, or --series")
    inputs = [place for places in pairs.values() for place in places if isinstance(place, Path)]
    inputs += mask or []
    require_writable("--out", out, force=force, inputs=inputs)
    if report is not None:
        if report.resolve() == out.resolve():
            refuse(f"--report and --out are one file, {out}: name two")
        require_writable("--report", report, force=force, endings=(".png", ".jpg"), inputs=inputs)
        require_package("plot", "matplotlib")
    import uwaug
    from uwaug._support import drawing
    from uwaug.io import read_mask
    from uwaug.jobs.sidecar import sidecar_of

    options: dict[str, Any] = {"color_space": color_space, "seed": seed}
    result: uwaug.fitting.Fit | uwaug.fitting.SeriesFit | uwaug.fitting.WaterFit
    with reported_errors(), status() as say:
        say("reading the pictures")
        masks: dict[str, Any] = {"mask": [read_mask(path) for path in mask]} if mask else {}
        if series is None:
            options |= {"focal_px": focal_px, "progress": say, **of_camera}
            read, notes = _read(pairs, format)
            pictures = {**read, **masks}
            if waters:
                result = uwaug.fitting.fit_water(**pictures, **options, **of_waters)
            else:
                result = uwaug.fit(**pictures, **options, model=model)
        else:
            files, turbidity = read_series(series)
            read, notes = _read(files, format)
            rows = list(zip(*read.values(), strict=True))
            options |= {"model": model, "progress": say}
            result = uwaug.fitting.fit_series(rows, turbidity, **masks, **options)
    try:
        result.save(out)
        if report is not None:
            drawing.save(result.plot(), report)
    except OSError as error:
        # what may have taken minutes is not lost
        print(cures_in_flags(result.summary()))
        fail(error)
    print(f"{cures_in_flags(result.summary())}\n")
    for note in notes:
        print(f"Note: {note}\n")
    # JPEG stores colours at half the resolution, which a fit takes for scattering
    pictures_named = [*pairs["clean"], *pairs["observed"]]
    lossy = {path.name for path in pictures_named if path.suffix.lower() in (".jpg", ".jpeg")}
    if lossy:
        moves = "which can move coefficients by more than their errors"
        names = ", ".join(sorted(lossy))
        print(f"Note: {names}: JPEG blurs colours, {moves}; prefer PNG or TIFF.\n")
    recorded = {path.name for path in pairs["observed"] if sidecar_of(path) is not None}
    if recorded and not waters:
        made = f"{', '.join(sorted(recorded))}: uwaug made it, by default of surfaces with spectra"
        print(f"Note: {made}, which coefficients do not have; see --waters.\n")
    print_written(out, report)


def _read(
    files: Mapping[str, list[Any]], format: "DistanceFormat"
) -> tuple[dict[str, Any], list[str]]:
    """The files, each of them once: what several pairs share stays one, and is blurred once. And
    what is worth knowing of the maps.
    """
    from uwaug.io import read_picture

    notes: list[str] = []

    @cache
    def picture(path: Path) -> "Tensor":
        return read_picture(path)

    @cache
    def metres(place: Path | float, size: tuple[int, int]) -> "Tensor":
        z, about = format.metres(place, size)
        notes.extend(f"{place}: {note}" for note in about)
        return z

    read = {name: [picture(path) for path in files[name]] for name in ("clean", "observed")}
    sizes = [(image.shape[-2], image.shape[-1]) for image in read["observed"]]
    read["distance"] = [
        metres(place, sizes[i % len(sizes)]) for i, place in enumerate(files["distance"])
    ]
    return read, notes


def read_series(path: Path) -> tuple[dict[str, list[Path]], list[float]]:
    """The files of each picture of a series by column, and its turbidity.

    Args:
        path: of a CSV with the columns clean, observed, distance (paths from its folder) and
            turbidity; others are not looked at.

    Raises:
        ValueError: if a column or a value is missing, or a turbidity is no number; names the line.
        OSError: if it cannot be read.
    """
    from uwaug._support.atomic import require_regular

    require_regular(path)
    files: dict[str, list[Path]] = {"clean": [], "observed": [], "distance": []}
    turbidity: list[float] = []
    # some spreadsheets begin a file with a mark
    with path.open(encoding="utf-8-sig", newline="") as file:
        reader = csv.DictReader(file, skipinitialspace=True)
        if not {*files, "turbidity"} <= set(reader.fieldnames or []):
            got = ", ".join(reader.fieldnames or []) or "none"
            expected = ", ".join([*files, "turbidity"])
            raise ValueError(f"{path}: expected the columns {expected}, got {got}")
        for row in reader:
            for name in (*files, "turbidity"):
                if not row[name]:
                    raise ValueError(f"{path}: line {reader.line_num} has no {name}")
            for name, paths in files.items():
                paths.append(path.parent / row[name])
            try:
                turbidity.append(float(row["turbidity"]))
            except ValueError:
                got = f"{row['turbidity']!r} in line {reader.line_num}"
                raise ValueError(f"{path}: turbidity must be a number, got {got}") from None
    if not turbidity:
        raise ValueError(f"{path}: holds no pictures: expected a line for each")
    return files, turbidity
