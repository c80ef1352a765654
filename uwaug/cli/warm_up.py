"""`uwaug warm-up`."""

from uwaug.cli.console import reported_errors, status


def warm_up() -> None:
    """Compile the fast loops (numba) now, so that no run waits for them."""
    from uwaug.formation import fused

    with reported_errors(), status() as say:
        say("compiling the loops")
        folder = fused.warm_up()
    if folder is None:
        print("The loops work, but no folder can be written to: every process compiles for itself.")
    else:
        print(f"The loops are compiled, and kept in {folder}")
