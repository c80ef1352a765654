"""The matrix of `benchmarks.stability` as an SVG: small, and legible without colours."""

from html import escape

_COLUMN, _ROW, _LEFT, _TOP = 72, 18, 172, 58
_FILLS = {"right": "#cfe8dc", "off": "#f6c66a", "fail": "#b3312c", "none": "#e4e4e4"}
_LEGEND = (
    ("right", "", "right"),
    ("off", ".06", "wrong by (value: of 1; gradient: of its norm)"),
    ("fail", "NaN", "NaN"),
    ("fail", "err", "exception"),
    ("fail", "??", "no error where one is due"),
    ("none", "–", "has none, or does not apply"),
)


def kind(verdict: str) -> str:
    """What a verdict comes to: right, off, NaN, silent, none or exception."""
    first = verdict.partition(" ")[0]
    if verdict in ("n/a", "none"):
        return "none"
    return first if first in ("right", "off", "NaN", "silent") else "exception"


def _mark(verdict: str) -> str:
    text = {"right": "", "none": "–", "NaN": "NaN", "silent": "??", "exception": "err"}.get(
        kind(verdict)
    )
    if text is not None:
        return text
    number = float(verdict.rpartition(" ")[2])
    if number < 1:
        return f"{number:.1g}".lstrip("0") if number >= 1e-3 else "<.001"
    return f"{number:.1f}" if number < 9.95 else f"{number:.0f}" if number < 999 else "≫1"


def svg(groups: dict[str, list[str]], result: dict[str, dict[str, dict[str, str]]]) -> str:
    """Rows of conditions, in groups; columns of methods; value in the left, gradient in the right half of each cell."""
    methods = list(next(iter(result.values())))
    boxes: dict[str, list[str]] = {name: [] for name in _FILLS}
    ticks: list[str] = []
    texts: list[str] = []

    def half(x: float, y: float, verdict: str, mark: str | None = None) -> None:
        look = {"right": "right", "off": "off", "none": "none"}.get(kind(verdict), "fail")
        mark = _mark(verdict) if mark is None else mark
        boxes[look].append(f"M{x:g} {y:g}h{_COLUMN / 2 - 1:g}v{_ROW - 2}h-{_COLUMN / 2 - 1:g}z")
        if look == "right":
            ticks.append(f"M{x + 13:g} {y + 8:g}l3 3 6-7")
        elif mark:
            shade = ' fill="#fff"' if look == "fail" else ""
            texts.append(f'<text x="{x + 17.5:g}" y="{y + 11.5:g}"{shade}>{mark}</text>')

    width = _LEFT + _COLUMN * len(methods) + 6
    y = _TOP
    for i, method in enumerate(methods):
        x = _LEFT + _COLUMN * i
        lines = [*method.split(" ", 1), ""][:2] if len(method) > 10 else [method, ""]
        weight = ' font-weight="bold"' if method == "uwaug" else ""
        for n, line in enumerate(lines):
            texts.append(
                f'<text x="{x + 36}" y="{18 + 13 * n + (0 if lines[1] else 6)}" class="h"{weight}>{line}</text>'
            )
        texts.append(f'<text x="{x + 17}" y="{_TOP - 8}" class="s">value</text>')
        texts.append(f'<text x="{x + 53}" y="{_TOP - 8}" class="s">grad.</text>')
    for group, names in groups.items():
        for name in names:
            texts.append(f'<text x="{_LEFT - 8}" y="{y + 12}" class="c">{escape(name)}</text>')
            for i, method in enumerate(methods):
                verdicts = result[name][method]
                half(_LEFT + _COLUMN * i, y, verdicts["value"])
                half(_LEFT + _COLUMN * i + _COLUMN / 2 - 1, y, verdicts["gradient"])
            y += _ROW
        texts.append(
            f'<text transform="translate(13 {y - _ROW * len(names) / 2:g})rotate(-90)" class="g">{group}</text>'
        )
        y += 7
    y += 6
    x = float(_LEFT)
    for look, mark, meaning in _LEGEND:
        if x + 44 + 6.2 * len(meaning) > width:
            x, y = float(_LEFT), y + 22
        half(x, y, look if look != "fail" else "NaN", mark)
        texts.append(f'<text x="{x + 42:g}" y="{y + 12}" class="l">{meaning}</text>')
        x += 64 + 6.2 * len(meaning)
    height = y + 28
    paths = "".join(
        f'<path fill="{_FILLS[look]}" d="{"".join(d)}"/>' for look, d in boxes.items() if d
    )
    style = (
        "text{font:10px sans-serif;text-anchor:middle;fill:#222}text[fill]{fill:#fff}.h{font-size:12px}"
        ".s{font-size:9px;fill:#666}.c,.l{font-size:12px}.c{text-anchor:end}.l{text-anchor:start}"
        ".g{font-size:11px;fill:#666}"
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}">'
        f'<style>{style}</style><rect width="100%" height="100%" fill="#fff"/>{paths}'
        f'<path d="{"".join(ticks)}" fill="none" stroke="#1c7a52" stroke-width="1.6"/>\n'
        + "\n".join(texts)
        + "\n</svg>\n"
    )
