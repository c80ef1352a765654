"""`uwaug degrade`."""

import inspect
import tomllib
from pathlib import Path
from typing import Any

from uwaug._support import checks
from uwaug.cli import degrade_options as given
from uwaug.cli.clusters import carry_out_in_shards, place_of, require_manner
from uwaug.cli.console import refuse
from uwaug.cli.runs import Manner, carry_out, rehearse, repeat, require_free
from uwaug.io.distances import DistanceFormat
from uwaug.io.write import FORMATS, format_of
from uwaug.jobs.items import MANIFESTS, Items, metres_in
from uwaug.jobs.pool import cores
from uwaug.jobs.recipe import Recipe
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.water import JERLOV_TYPES
from uwaug.transforms.options import contrast_of
from uwaug.transforms.random_underwater import RandomUnderwater

__all__ = ["degrade"]

_FEW = 8
"""Pictures that this process has done before others have begun."""

_NOT_OPTIONS = (
    "distance_kind",
    "distance",
    "unknown",
    "same_on_batch",
    "image_key",
    "distance_key",
)
"""Arguments of `RandomUnderwater` that files have no use for, or that flags say."""


def degrade(
    inputs: given.Inputs = None,
    out: given.Out = None,
    distance: given.Distance = None,
    water: given.WaterType = None,
    preset: given.PresetName = None,
    fit: given.FitFile = None,
    random: given.Random = False,
    options: given.Options = None,
    visibility: given.Visibility = None,
    contrast: given.Contrast = None,
    severity: given.Severity = None,
    depth: given.VerticalDepth = None,
    exposure: given.Exposure = None,
    distance_kind: given.Kind = "metric",
    distance_unit: given.Unit = "m",
    unknown: given.Unknown = "error",
    near: given.Near = None,
    far: given.Far = None,
    gamma: given.Gamma = None,
    focal_px: given.Focal = None,
    baseline: given.Baseline = None,
    offset_px: given.Offset = 0.0,
    planar: given.Planar = False,
    depth_network: given.Network = None,
    seed: given.Seed = 0,
    variants: given.Variants = 1,
    output_format: given.Format = None,
    workers: given.Workers = None,
    ray: given.Ray = None,
    shards: given.InShards = None,
    resume: given.Resume = False,
    force: given.Force = False,
    labels: given.LabelFiles = None,
    min_contrast: given.MinContrast = None,
    void: given.Void = None,
    keep_terms: given.Terms = False,
    sheet: given.Sheet = False,
    dry_run: given.DryRun = False,
    again: given.From = None,
) -> None:
    """Your pictures, under water: with a record beside each, and an index of all."""
    depth_options = {
        "kind": distance_kind,
        "unit": _number(distance_unit),
        "focal_px": focal_px,
        "baseline_m": baseline,
        "offset_px": offset_px,
        "planar": planar,
        "unknown": _number(unknown),
        "network": None if depth_network is None else str(depth_network),
    }
    flags = {
        "visibility": visibility,
        "contrast": contrast,
        "vertical_depth": depth,
        "exposure": exposure,
        "near": near,
        "far": far,
        "gamma": gamma,
    }
    place = place_of(out, shards, alone=again is not None)
    if again is not None:
        others = (water, preset, fit, random, options, seed, keep_terms, labels, *flags.values())
        if len(inputs or []) > 1 or any(others):
            refuse("--from takes all from the record: give nothing but --out and files that moved")
        repeat(again, place, force, inputs or [], distance)
        return
    if not inputs:
        refuse("expected a picture, a folder of pictures, a list of them, or --from")
    try:
        drawn = _options(options, flags, severity)
        if focal_px is not None and preset is None and fit is None:
            drawn.setdefault("focal_px", focal_px)
        recipe = Recipe(
            water=_jerlov(water),
            preset=preset,
            fit=None if fit is None else str(fit),
            random=random,
            options=drawn,
            distance=_format(depth_options, distance),
            seed=seed,
            labels=None if labels is None else str(labels),
            min_contrast=min_contrast,
            void=void,
            keep_terms=keep_terms,
        ).resolved()
        items = _items(inputs, place, distance, variants, output_format, depth_network is not None)
        _require_folder(items, shards)
        source = recipe.open_labels()
    except (TypeError, ValueError, OSError, ImportError) as error:
        refuse(error)
    manner = Manner(_workers(workers, len(items), ray), resume, force, sheet, ray)
    require_manner(manner, shards, workers, keep_terms=keep_terms)
    require_free(items, recipe, manner, in_files=shards is None)
    if dry_run:
        rehearse(items, recipe, manner, source)
    elif shards is None:
        carry_out(items, recipe, manner, source)
    else:
        carry_out_in_shards(items, recipe, manner, source, shards)


def _options(path: Path | None, flags: dict[str, str | None], severity: int | None) -> Any:
    """Options of `RandomUnderwater`, from a file and from flags."""
    found: dict[str, Any] = {}
    if path is not None:
        try:
            found = tomllib.loads(path.read_text(encoding="utf-8"))
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise ValueError(f"{path}: is no TOML: {error}") from None
        known = inspect.signature(RandomUnderwater).parameters
        for name in found:
            if name not in known or name in _NOT_OPTIONS:
                wanted = ", ".join(name for name in known if name not in _NOT_OPTIONS)
                raise ValueError(f"{path}: unknown key {name}; there are {wanted}")
        _require_point_spread(path, found.get("point_spread"))
    for name, text in flags.items():
        if text is not None:
            found[name] = text if text in ("auto", "none") else _range(name, text)
    if severity is not None:
        if "contrast" in found:
            raise ValueError("severity and contrast: give one of them")
        checks.within("severity", severity, 1, 5)
        found["contrast"] = contrast_of(severity)
    return found


def _require_point_spread(path: Path, table: Any) -> None:
    """Refuse a table that is no `PointSpread`."""
    known = inspect.signature(PointSpread).parameters
    wanted = f"expected a table with scale and, if you like, {', '.join(list(known)[1:])}"
    if table is None:
        return
    if not isinstance(table, dict):
        raise ValueError(f"{path}: point_spread: {wanted}, got {table!r}")
    for name in table:
        if name not in known:
            raise ValueError(f"{path}: point_spread: unknown key {name}: {wanted}")
    if "scale" not in table:
        raise ValueError(f"{path}: point_spread: scale is missing: {wanted}")


def _jerlov(water: str | None) -> str | None:
    """A Jerlov type, which may be given in small letters."""
    if water is None:
        return None
    checks.one_of("water", water.upper(), JERLOV_TYPES)
    return water.upper()


def _range(name: str, text: str) -> float | list[float]:
    """A number, or two with a colon between them."""
    try:
        numbers = [float(part) for part in text.split(":")]
    except ValueError:
        numbers = []
    if len(numbers) not in (1, 2):
        raise ValueError(f"{name} must be a number, or a range such as 2:10, got {text!r}")
    return numbers[0] if len(numbers) == 1 else numbers


def _number(text: str) -> str | float:
    """A number where there is one."""
    try:
        return float(text)
    except ValueError:
        return text


def _format(options: dict[str, Any], distance: str | None) -> DistanceFormat:
    """What the distance files of a run hold."""
    format = DistanceFormat(**_inverse_of_network(options))
    if format.network is None and distance is not None and metres_in(distance) is not None:
        format.require_constant()
    return format


def _inverse_of_network(options: dict[str, Any]) -> dict[str, Any]:
    """Depth networks give inverse depth, whatever the default is."""
    if options["network"] is not None and options["kind"] == "metric":
        options = {**options, "kind": "inverse"}
    return options


def _items(
    inputs: list[Path],
    out: Path,
    distance: str | None,
    variants: int,
    output_format: str | None,
    network: bool,
) -> Items:
    checks.within("variants", variants, 1)
    if network and distance is not None:
        raise ValueError("--depth-network takes the place of --distance: give one of them")
    ending = None
    if output_format is not None:
        ending = f".{output_format.lower().removeprefix('.')}"
        format_of(f"picture{ending}")
    alone = len(inputs) == 1 and not inputs[0].is_dir() and inputs[0].suffix not in MANIFESTS
    if alone and variants == 1 and out.suffix.lower() in FORMATS and not out.is_dir():
        return Items(inputs, distance, out.parent, network=network, name=out.name)
    return Items(inputs, distance, out, variants=variants, ending=ending, network=network)


def _require_folder(items: Items, shards: str | None) -> None:
    """Refuse a folder that looks like a file that cannot be written."""
    alone = items.name is not None or shards is not None
    if not alone and items.out.suffix and not items.out.is_dir():
        ends = ", ".join(FORMATS)
        wanted = f"the file of one picture, which ends in {ends}, or a folder"
        cure = "make the folder first if it is to be called so"
        raise ValueError(f"--out {items.out}: expected {wanted}: {cure}")


def _workers(wanted: int | None, count: int, ray: str | None) -> int:
    if wanted is not None:
        if wanted < 1:
            refuse(f"--workers must be at least 1, got {wanted}")
        return wanted
    # a worker takes three seconds to begin
    return 1 if count < _FEW and ray is None else min(cores(), count)
