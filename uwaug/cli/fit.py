"""`uwaug fit`."""

from collections.abc import Callable
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, get_args

import typer
from torch import Tensor

import uwaug
from uwaug._support import checks
from uwaug._support.types import ColorSpace
from uwaug.cli.console import fail, refuse, require_matplotlib, require_room, said
from uwaug.cli.series import read_series
from uwaug.fitting.structure import MODELS, Gain

__all__ = ["fit"]

_DRAWN = (".png", ".jpg")
"""Endings of reports."""

Clean = Annotated[
    list[Path] | None,
    typer.Option(help="Picture of the scene without water. One serves all observed ones."),
]
Observed = Annotated[
    list[Path] | None,
    typer.Option(help="Picture of the scene in the water. Repeat it, for several of one water."),
]
Distance = Annotated[
    list[Path] | None,
    typer.Option(help="Distance of each pixel: .npy, .npz, TIFF, PNG, PFM, EXR."),
]
Series = Annotated[
    Path | None,
    typer.Option(
        help="In place of these three: a CSV of pictures at several turbidities, with the columns "
        "clean, observed, distance (paths from its folder) and turbidity."
    ),
]
Unit = Annotated[str, typer.Option(help="Of the numbers in distance files: m, cm, mm or um.")]
ModelName = Annotated[str, typer.Option(help=f"auto, or one of {', '.join(MODELS)}.")]
GainKind = Annotated[
    str, typer.Option(help="fixed: one exposure; free: a gain for each picture; channels: colour.")
]
Colours = Annotated[str, typer.Option(help="Of the pictures: srgb, or linear light.")]
FocalPx = Annotated[float | None, typer.Option(help="Focal length, px: lets it try calibrated.")]
Mask = Annotated[list[Path] | None, typer.Option(help="Pictures that are > 0 where pixels count.")]
Seed = Annotated[int, typer.Option(help="Of the pixels that are drawn, and of random starts.")]
Out = Annotated[Path, typer.Option(help="The JSON file to write.")]
Report = Annotated[Path | None, typer.Option(help="A picture of the fit too: .png or .jpg.")]
Force = Annotated[bool, typer.Option("--force", help="Write over existing files.")]


def fit(
    out: Out,
    clean: Clean = None,
    observed: Observed = None,
    distance: Distance = None,
    series: Series = None,
    distance_unit: Unit = "m",
    model: ModelName = "auto",
    gain: GainKind = "fixed",
    color_space: Colours = "srgb",
    focal_px: FocalPx = None,
    mask: Mask = None,
    seed: Seed = 0,
    report: Report = None,
    force: Force = False,
) -> None:
    """Which water is it? Coefficients, and how sure they are."""
    given = {"clean": clean or [], "observed": observed or [], "distance": distance or []}
    options: dict[str, Any] = {"model": model, "color_space": color_space, "seed": seed}
    alone = {"gain": gain, "focal_px": focal_px}
    _require_options(distance_unit, {**options, **alone})
    if series is None:
        _require_pairs(given, mask or [])
        options |= alone
    elif any(given.values()) or alone != {"gain": "fixed", "focal_px": None}:
        names = "--clean, --observed, --distance, --gain or --focal-px"
        refuse(f"--series takes the place of pairs of one water: expected no {names} beside it")
    _require_files(out, report, force)
    _require_inputs_kept([out, report], [*chain(*given.values()), *(mask or [])])
    try:
        with said() as say:
            say("reading the pictures")
            options["progress"] = say
            if mask:
                options |= _read({"mask": mask}, distance_unit)
            if series is None:
                found: uwaug.fitting.Fit | uwaug.fitting.SeriesFit = uwaug.fit(
                    **_read(given, distance_unit), **options
                )
            else:
                found = _fit_series(series, distance_unit, options)
    except (OSError, ValueError) as error:
        fail(error)
    try:
        _write(found, out, report)
    except OSError as error:
        # what may have taken minutes is not lost
        print(found.summary())
        fail(error)
    print(f"{found.summary()}\n")
    _say_lossy([*given["clean"], *given["observed"]])
    for path in filter(None, (out, report)):
        print(f"{path}  ({path.stat().st_size / 1024:.0f} KiB)")


def _say_lossy(pictures: list[Path]) -> None:
    """JPEG stores colours at half the resolution, which a fit takes for scattering."""
    lossy = sorted({path.name for path in pictures if path.suffix.lower() in (".jpg", ".jpeg")})
    if lossy:
        moves = "which can move coefficients by more than their errors"
        print(f"Note: {', '.join(lossy)}: JPEG blurs colours, {moves}; prefer PNG or TIFF.\n")


def _write(
    found: uwaug.fitting.Fit | uwaug.fitting.SeriesFit, out: Path, report: Path | None
) -> None:
    from uwaug._support import sheet as sheets

    found.save(out)
    if report is not None:
        sheets.save(found.plot(), report)


def _require_options(distance_unit: str, options: dict[str, Any]) -> None:
    """Refuse what no pictures could make good."""
    from uwaug.io.distances import UNITS

    try:
        checks.one_of("--distance-unit", distance_unit, UNITS)
        checks.one_of("--model", options["model"], ("auto", *MODELS))
        checks.one_of("--gain", options["gain"], get_args(Gain))
        checks.one_of("--color-space", options["color_space"], get_args(ColorSpace))
        checks.within("--seed", options["seed"], 0)
        if options["focal_px"] is not None:
            checks.positive("--focal-px", options["focal_px"], "px")
    except ValueError as error:
        refuse(error)
    if options["model"] == "calibrated" and options["focal_px"] is None:
        refuse("--model calibrated needs --focal-px, the focal length in px")


def _require_pairs(given: dict[str, list[Path]], mask: list[Path]) -> None:
    """Refuse what makes up no pairs."""
    for name, paths in given.items():
        if not paths:
            cure = "a fit needs --clean, --observed and --distance, or --series"
            refuse(f"--{name} is missing: {cure}")
    if mask:
        given = {**given, "mask": mask}
    most = max(map(len, given.values()))
    got = []
    for name, paths in given.items():
        got.append(f"{len(paths)} of --{name}")
    for paths in given.values():
        if len(paths) not in (1, most):
            refuse(f"expected one of each or as many as of the others, got {', '.join(got)}")


def _require_files(out: Path, report: Path | None, force: bool) -> None:
    """Before any work."""
    require_room(out, force)
    if report is None:
        return
    if report.suffix not in _DRAWN:
        refuse(f"--report must end in {' or '.join(_DRAWN)}, got {report}")
    if report.resolve() == out.resolve():
        refuse(f"--report and --out are one file, {out}: name two")
    require_room(report, force)
    require_matplotlib("a report is drawn")


def _require_inputs_kept(written: list[Path | None], read: list[Path]) -> None:
    """Refuse to write over what is read, --force or not."""
    for path in filter(None, written):
        if path.resolve() in {one.resolve() for one in read}:
            refuse(f"{path} is one of the pictures: choose another file to write")


def _fit_series(path: Path, unit: str, options: dict[str, Any]) -> uwaug.fitting.SeriesFit:
    files, turbidity = read_series(path)
    pictures = _read(files, unit)
    pairs = list(zip(*pictures.values(), strict=True))
    return uwaug.fitting.fit_series(pairs, turbidity, **options)


def _read(given: dict[str, list[Path]], unit: str) -> dict[str, Any]:
    """The files, each of them once: what several pairs share stays one, and is blurred once."""
    from uwaug.io.distances import read_distance, read_mask
    from uwaug.io.read import read_picture

    readers: dict[str, Callable[[Path], Tensor]] = {
        "clean": read_picture,
        "observed": read_picture,
        "distance": lambda path: read_distance(path, unit),
        "mask": read_mask,
    }
    found: dict[str, list[Tensor]] = {}
    for name, paths in given.items():
        known: dict[Path, Tensor] = {}
        for path in paths:
            if path not in known:
                known[path] = readers[name](path)
        found[name] = [known[path] for path in paths]
    return found
