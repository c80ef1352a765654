"""A random number that is added as the house README says: a field of its noun, and its use in `of`.
Here it is the stops that the port of a housing takes.
"""

from pathlib import Path

from edited import edited_copy, run_in
from filing import pixels, save

PORT = {
    "transforms/random_development.py": {
        "    noise: Sensor | None = None\n": (
            "    noise: Sensor | None = None\n    port: Range = number(0.0, 0.0, 3.0)\n"
        ),
        '        options: dict[str, Any] = {**draw, "metered": self.metered}\n': (
            '        options: dict[str, Any] = {**draw, "metered": self.metered}\n'
            '        options["exposure"] -= options.pop("port")\n'
        ),
    }
}
SEEN = """
import json, pytest, torch, uwaug
from pathlib import Path
from typer.testing import CliRunner
from uwaug.cli.app import app
from uwaug.files import read_record, replay

generator = torch.Generator().manual_seed(0)
image, distance = torch.rand(3, 24, 32, generator=generator), torch.full((1, 24, 32), 2.0)
camera = uwaug.RandomDevelopment(exposure=0.0, metered=False, port=(1.0, 2.0))
augment = uwaug.RandomUnderwater("II", development=camera)

# it is drawn, and acts
record = augment.make_params(image, generator)
drawn = record["samples"][0]["development"]
assert 1 < drawn["port"] < 2
made = augment.transform(image, distance, record)
record["samples"][0]["development"] = {**drawn, "port": 0.0, "exposure": -drawn["port"]}
assert torch.equal(augment.transform(image, distance, record), made)

# it is read, refused and fixed as all others
record["samples"][0]["development"] = {**drawn, "port": 9.0}
with pytest.raises(ValueError, match=r"development.port must be in \\[0, 3\\], got 9"):
    augment.transform(image, distance, record)
twin = uwaug.RandomUnderwater.from_dict(json.loads(json.dumps(augment.to_dict())))
assert twin.development == camera
with pytest.raises(ValueError, match="development.port"):
    augment.module()

# it is an option of the command line, and replayed from what that writes
line = "degrade photo.png --distance 2 --set development.port=1:2 --out wet"
done = CliRunner().invoke(app, line.split())
assert done.exit_code == 0, done.output
(sample,) = read_record(Path("wet/photo.png.json"))["params"]["samples"]
assert 1 < sample["development"]["port"] < 2
replay("wet/photo.png.json", "again.png")
assert Path("again.png").read_bytes() == Path("wet/photo.png").read_bytes()
"""


def test_it_is_drawn_recorded_replayed_and_an_option(tmp_path: Path) -> None:
    edited_copy(tmp_path, PORT)
    save(tmp_path / "photo.png", pixels(24, 32))
    run_in(tmp_path, "-c", SEEN, UWAUG_FAST="0")
