"""A term of the image with a number of its own, put in as the house README says: plankton that
glows. What it reaches is in glow.py, whose tests run in a copy of the package that has it.
"""

from pathlib import Path

from edited import edited_copy, run_in

from uwaug import fast

TESTS = Path(__file__).parent
GLOW = {
    "optics/medium.py": {
        "    snow: tuple[MarineSnow | None, ...] = ()\n\n    def __post": (
            "    snow: tuple[MarineSnow | None, ...] = ()\n"
            "    glow: Tensor = absent()\n\n    def __post"
        ),
        "        return {}\n": (
            '        return {"glow": self.glow[..., None, None] * -torch.expm1(-z)}\n'
        ),
        '        "signal_weights": "BCSL",\n': (
            '        "signal_weights": "BCSL",\n        "glow": "BC",\n'
        ),
    },
    "formation/image.py": {
        "    backscatter: Tensor\n": "    backscatter: Tensor\n    glow: Tensor\n"
    },
}


def test_it_reaches_all_that_a_term_has_to(tmp_path: Path) -> None:
    """With its line in the midst of the tensors."""
    fast.warm_up()  # what is compiled here need not be compiled there
    edited_copy(tmp_path, GLOW)
    settings = ["-c", str(TESTS.parent / "pyproject.toml"), "--rootdir", str(TESTS.parent)]
    options = ["-q", "-n", "0", "-p", "no:cacheprovider", "--show-capture=no", *settings]
    run_in(tmp_path, "-m", "pytest", *options, str(TESTS / "glow.py"))
