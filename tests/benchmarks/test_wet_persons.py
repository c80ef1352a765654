"""Halves of a kit that share no film."""

from types import SimpleNamespace

from benchmarks.evidence import wet_persons
from benchmarks.evidence.detector import TESTS, Bench


def test_home_shares_no_film_with_what_is_tuned_on() -> None:
    blocks = {name: [f"{name} {i // 4}" for i in range(20)] for name in TESTS}
    tests = {name: [SimpleNamespace(name=i) for i in range(20)] for name in TESTS}
    bench = Bench(*[None] * len(Bench._fields))._replace(tests=tests, blocks=blocks)
    learnt, home = wet_persons.directions(bench)[wet_persons.HOME]
    for name in (wet_persons.SWIMMERS, wet_persons.POOLS):
        assert not {*learnt.blocks[name]} & {*home.blocks[name]}
        assert len(learnt.tests[name]) + len(home.tests[name]) == 20
        assert min(len(learnt.tests[name]), len(home.tests[name])) == 8
        assert [f"{name} {x.name // 4}" for x in home.tests[name]] == home.blocks[name]
