"""The matrix of `benchmarks.accuracy.stability` as an SVG: small, and legible without colours."""

from html import escape

_COLUMN, _ROW, _LEFT, _TOP = 72, 18, 172, 58
_HALF = _COLUMN / 2 - 1
_FILLS = {"right": "#cfe8dc", "off": "#f6c66a", "fail": "#b3312c", "none": "#e4e4e4"}
_LEGEND = (
    ("right", "", "right"),
    ("off", ".06", "wrong by (value: of 1; gradient: of its norm)"),
    ("fail", "NaN", "NaN"),
    ("fail", "err", "exception"),
    ("fail", "??", "no error where one is due"),
    ("none", "–", "has none, or does not apply"),
)
_MARKS = {"right": "", "none": "–", "NaN": "NaN", "silent": "??", "exception": "err"}
_STYLE = (
    "text{font:10px sans-serif;text-anchor:middle;fill:#222}text[fill]{fill:#fff}"
    ".h{font-size:12px}.s{font-size:9px;fill:#666}.c,.l{font-size:12px}.c{text-anchor:end}"
    ".l{text-anchor:start}.g{font-size:11px;fill:#666}"
)


def kind(verdict: str) -> str:
    """What a verdict comes to: right, off, NaN, silent, none or exception."""
    first = verdict.partition(" ")[0]
    if verdict in ("n/a", "none"):
        return "none"
    return first if first in ("right", "off", "NaN", "silent") else "exception"


def svg(groups: dict[str, list[str]], result: dict[str, dict[str, dict[str, str]]]) -> str:
    """Rows of conditions, in groups; columns of methods; value in the left, gradient in the right
    half of each cell.
    """
    methods = list(next(iter(result.values())))
    sheet = _Sheet(_LEFT + _COLUMN * len(methods) + 6)
    for i, method in enumerate(methods):
        sheet.head(_LEFT + _COLUMN * i, method)
    y = _TOP
    for group, names in groups.items():
        for name in names:
            sheet.write(_LEFT - 8, y + 12, escape(name), "c")
            for i, method in enumerate(methods):
                x, verdicts = _LEFT + _COLUMN * i, result[name][method]
                sheet.half(x, y, verdicts["value"])
                sheet.half(x + _HALF, y, verdicts["gradient"])
            y += _ROW
        middle = f"translate(13 {y - _ROW * len(names) / 2:g})rotate(-90)"
        sheet.texts.append(f'<text transform="{middle}" class="g">{group}</text>')
        y += 7
    return sheet.finished(sheet.legend(y + 6) + 28)


class _Sheet:
    """An SVG in the making; boxes of one colour and ticks are one path each."""

    def __init__(self, width: int) -> None:
        self.width = width
        self.boxes: dict[str, list[str]] = {name: [] for name in _FILLS}
        self.ticks: list[str] = []
        self.texts: list[str] = []

    def write(self, x: float, y: float, text: str, style: str, more: str = "") -> None:
        self.texts.append(f'<text x="{x:g}" y="{y}" class="{style}"{more}>{text}</text>')

    def half(self, x: float, y: float, verdict: str, mark: str | None = None) -> None:
        """One half of a cell, with its mark."""
        look = kind(verdict) if kind(verdict) in _FILLS else "fail"
        mark = _mark(verdict) if mark is None else mark
        self.boxes[look].append(f"M{x:g} {y:g}h{_HALF:g}v{_ROW - 2}h-{_HALF:g}z")
        if look == "right":
            self.ticks.append(f"M{x + 13:g} {y + 8:g}l3 3 6-7")
        elif mark:
            shade = ' fill="#fff"' if look == "fail" else ""
            self.texts.append(f'<text x="{x + 17.5:g}" y="{y + 11.5:g}"{shade}>{mark}</text>')

    def head(self, x: int, method: str) -> None:
        """The name of a column, in two lines if it is long."""
        first, _, second = method.partition(" ") if len(method) > 10 else (method, "", "")
        weight = ' font-weight="bold"' if method == "uwaug" else ""
        self.write(x + 36, 18 if second else 24, first, "h", weight)
        self.write(x + 36, 31 if second else 37, second, "h", weight)
        self.write(x + 17, _TOP - 8, "value", "s")
        self.write(x + 53, _TOP - 8, "grad.", "s")

    def legend(self, y: float) -> float:
        """What the marks mean, from `y` on; returns where the last line stands."""
        x = float(_LEFT)
        for look, mark, meaning in _LEGEND:
            if x + 44 + 6.2 * len(meaning) > self.width:
                x, y = float(_LEFT), y + 22
            self.half(x, y, look if look != "fail" else "NaN", mark)
            self.write(x + 42, y + 12, meaning, "l")
            x += 64 + 6.2 * len(meaning)
        return y

    def finished(self, height: float) -> str:
        """The file."""
        paths = []
        for look, boxes in self.boxes.items():
            if boxes:
                paths.append(f'<path fill="{_FILLS[look]}" d="{"".join(boxes)}"/>')
        size = f'viewBox="0 0 {self.width} {height}" width="{self.width}" height="{height}"'
        ticks = f'd="{"".join(self.ticks)}" fill="none" stroke="#1c7a52" stroke-width="1.6"'
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" {size}>'
            f'<style>{_STYLE}</style><rect width="100%" height="100%" fill="#fff"/>'
            f"{''.join(paths)}<path {ticks}/>\n" + "\n".join(self.texts) + "\n</svg>\n"
        )


def _mark(verdict: str) -> str:
    text = _MARKS.get(kind(verdict))
    if text is not None:
        return text
    number = float(verdict.rpartition(" ")[2])
    if number < 1:
        return f"{number:.1g}".lstrip("0") if number >= 1e-3 else "<.001"
    if number < 999:
        return f"{number:.1f}" if number < 9.95 else f"{number:.0f}"
    return "≫1"
