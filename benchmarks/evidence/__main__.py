"""`python -m benchmarks.evidence`, see `benchmarks.evidence.training`."""

from benchmarks.evidence.training import command

if __name__ == "__main__":
    command()
