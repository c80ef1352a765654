"""`uwaug warm-up`."""

from uwaug.cli.console import reported_errors, status


def warm_up() -> None:
    """Compile the fast loops (numba) now, so that no run waits for them."""
    from uwaug import fast

    with reported_errors(), status() as say:
        say("compiling the loops")
        fast.warm_up()
    print("The loops are compiled.")
