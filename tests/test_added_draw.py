"""What is drawn, added as the house README says: a noun, here a lens that darkens the rim of a
picture; and a number of a noun that there is, here the stops that the port of a housing takes.
"""

from pathlib import Path

from edited import edited_copy, run_in
from filing import pixels, save

LENS = '''"""A lens that darkens the rim of a picture."""

from dataclasses import dataclass

from torch import Tensor

from uwaug._support.codec import plain
from uwaug.optics.view import View


@plain
@dataclass(frozen=True)
class Lens:
    vignetting: float

    def passing(self, z: Tensor, view: View) -> Tensor:
        return 1 - self.vignetting * (1 - view.rays(z).shortening ** 4)
'''
RANDOM_LENS = '''"""A lens of which the vignetting is random."""

from dataclasses import dataclass

from uwaug._support import codec
from uwaug._support.nouns import Drawn, Noun, number
from uwaug._support.ranges import Range
from uwaug.optics.lens import Lens
from uwaug.transforms.measured import Measured


@codec.plain
@dataclass(frozen=True, repr=False)
class RandomLens(Noun):
    vignetting: Range = number(0.0, 0.0, 1.0)

    def of(self, drawn: Drawn, measured: Measured) -> Lens | None:
        return Lens(**drawn) if drawn["vignetting"] else None
'''
EDITS = {
    "transforms/random_underwater.py": {
        "import RandomLight\n": (
            "import RandomLight\nfrom uwaug.transforms.random_lens import RandomLens\n"
        ),
        "    view: View = WIDE\n": (
            "    lens: RandomLens = option(default_factory=RandomLens)\n    view: View = WIDE\n"
        ),
        "        view: View | float = WIDE,\n": (
            "        lens: RandomLens | None = None,\n        view: View | float = WIDE,\n"
        ),
        "        self.view = View.of(view)\n": (
            "        self.lens = lens or RandomLens()\n        self.view = View.of(view)\n"
        ),
        "light_noun, self.development)": "light_noun, self.development, self.lens)",
    },
    "transforms/random_development.py": {
        "    noise: Sensor | None = _SENSOR\n": (
            "    noise: Sensor | None = _SENSOR\n    port: Range = number(0.0, 0.0, 3.0)\n"
        ),
        '        options: dict[str, Any] = {**draw, "metered": self.metered}\n': (
            '        options: dict[str, Any] = {**draw, "metered": self.metered}\n'
            '        options["exposure"] -= options.pop("port")\n'
        ),
    },
    "transforms/draws.py": {
        '"light", "development")': '"light", "development", "lens")',
        "    development: Drawn\n": "    development: Drawn\n    lens: Drawn\n",
    },
    "transforms/scenes.py": {
        "development, view, space, span)": (
            'development, view, space, span, nouns["lens"].of(draw.lens, of_film))'
        )
    },
    "formation/setting.py": {
        "import Medium\n": "import Medium\nfrom uwaug.optics.lens import Lens\n",
        "(0.0, 0.0, 0.0)\n\n    def": "(0.0, 0.0, 0.0)\n    lens: Lens | None = None\n\n    def",
    },
    "formation/underwater.py": {
        "        view: View | float = WIDE,\n": (
            "        view: View | float = WIDE,\n        lens: Any = None,\n"
        ),
        "        self.tolerance = tolerance\n": (
            "        self.tolerance, self.lens = tolerance, lens\n"
        ),
    },
    "formation/image.py": {
        "    def stored(z: Tensor, J: Tensor, soft: Tensor, *": (
            "    def stored(z: Tensor, J: Tensor, soft: Tensor, passing: Tensor, *"
        ),
        "        arriving = medium.image(z, J, soft, T)\n": (
            "        arriving = medium.image(z, J, soft, T) * passing\n"
        ),
        "    shares = (z, J, soft) if normals is None else (z, J, soft, normals)\n": (
            "    lens = setting.lens\n"
            "    passing = torch.ones_like(z) if lens is None else lens.passing(z, setting.view)\n"
            "    shares = (z, J, soft, passing, *(() if normals is None else (normals,)))\n"
        ),
    },
}
SEEN = """
import json, pytest, torch, uwaug
from pathlib import Path
from typer.testing import CliRunner
from uwaug import fast
from uwaug.cli.app import app
from uwaug.files import read_record, replay
from uwaug.optics.lens import Lens
from uwaug.transforms.random_lens import RandomLens

generator = torch.Generator().manual_seed(0)
image, distance = torch.rand(3, 24, 32, generator=generator), torch.full((1, 24, 32), 2.0)
options = {"light": None, "distance": 2.0}
water = uwaug.RandomWater("II", field=None, vertical_depth=5.0, mu=0.03, color_matrix=None)


def transform(vignetting, port=0.0):
    lens = RandomLens(vignetting)
    camera = uwaug.RandomDevelopment(**uwaug.RandomDevelopment.PLAIN, port=port)
    return uwaug.RandomUnderwater(water, development=camera, lens=lens, **options)


# both are drawn, and act
augment = transform((0.5, 1.0), (1.0, 2.0))
record = augment.make_params(image, generator)
(sample,) = record["samples"]
port = sample["development"]["port"]
assert 0.5 < sample["lens"]["vignetting"] < 1 < port < 2
dim = augment.transform(image, None, record)
sample["development"] |= {"port": 0.0, "exposure": -port}
assert torch.equal(augment.transform(image, None, record), dim)
sample["development"]["exposure"] = 0.0
made = augment.transform(image, None, record)
sample["lens"] = {"vignetting": 0.0}
assert (augment.transform(image, None, record) - made)[:, 0, 0].mean() > 0.05

# they are read, refused and fixed as all others
twin = uwaug.RandomUnderwater.from_dict(json.loads(json.dumps(augment.to_dict())))
assert (twin.lens, twin.development) == (augment.lens, augment.development)
for noun, name in (("lens", "vignetting"), ("development", "port")):
    wrong = json.loads(json.dumps(record))
    wrong["samples"][0][noun][name] = 9.0
    with pytest.raises(ValueError, match=f"{noun}.{name} must be in .*, got 9"):
        augment.transform(image, None, wrong)
with pytest.raises(ValueError, match="development.port, lens.vignetting differ"):
    augment.module()

# modules, their states and what is made of their settings have it; the loops refuse it
module = transform(0.8).module()
assert module.lens == Lens(0.8)
assert "Lens(vignetting=0.8)" in repr(module)
assert not fast.can(image[None], distance[None], module.setting)
assert fast.can(image[None], distance[None], transform(0.0).module().setting)
shown = module(image, distance)
bare = transform(0.0).module()
assert (bare(image, distance) - shown)[:, 0, 0].mean() > 0.05
assert torch.equal(uwaug.Underwater.of(module.setting, (2.0, 2.02))(image, distance), shown)
bare.load_state_dict(module.state_dict())
assert torch.equal(bare(image, distance), shown)

# they are options of the command line, and replayed from what that writes
line = "degrade photo.png --distance 2 --set lens.vignetting=.5:1 --set development.port=1:2"
done = CliRunner().invoke(app, [*line.split(), "--out", "wet"])
assert done.exit_code == 0, done.output
(sample,) = read_record(Path("wet/photo.png.json"))["params"]["samples"]
assert 0.5 < sample["lens"]["vignetting"] < 1 < sample["development"]["port"] < 2
replay("wet/photo.png.json", "again.png")
assert Path("again.png").read_bytes() == Path("wet/photo.png").read_bytes()
"""


def test_they_are_drawn_recorded_replayed_and_in_modules(tmp_path: Path) -> None:
    edited_copy(tmp_path, EDITS)
    (tmp_path / "uwaug" / "optics" / "lens.py").write_text(LENS)
    (tmp_path / "uwaug" / "transforms" / "random_lens.py").write_text(RANDOM_LENS)
    save(tmp_path / "photo.png", pixels(24, 32))
    run_in(tmp_path, "-c", SEEN)
