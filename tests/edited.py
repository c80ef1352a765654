"""Copies of the package with something new in them, put in as the house README says."""

import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import uwaug

PACKAGE = Path(uwaug.__file__).parent


def edited_copy(folder: Path, edits: Mapping[str, Mapping[str, str]]) -> None:
    """The package in a folder: by file, what is written in place of a text that it has once."""
    # with what is compiled of files that stay as they are
    shutil.copytree(PACKAGE, folder / PACKAGE.name)
    for name, changes in edits.items():
        file = folder / PACKAGE.name / name
        text = file.read_text(encoding="utf-8")
        for before, after in changes.items():
            assert text.count(before) == 1, f"{name} has {text.count(before)} times {before!r}"
            text = text.replace(before, after)
        file.write_text(text, encoding="utf-8")


def run_in(folder: Path, *arguments: str, **environment: str) -> None:
    """Python with these arguments, where the copy in a folder is the package."""
    done = subprocess.run(
        [sys.executable, *arguments],
        check=False,
        capture_output=True,
        text=True,
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(folder)} | environment,
    )
    assert done.returncode == 0, done.stdout + done.stderr
