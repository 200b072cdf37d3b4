"""Random input is accepted or refused with a message, never with a traceback."""

import cheap
import hypothesis
import numpy as np
import pytest
from bad_commands import dispersion, normal
from hypothesis import strategies as st

from jentry.addresses import leaves_by_address, unit_of
from jentry.campaign.dispersions import check_dispersions
from jentry.cli.options import chosen_scenario, dispersion_table
from jentry.missions import ALL
from jentry.units import degree, parse_quantity


ADDRESSES = sorted(leaves_by_address(cheap.scenario()))
UNITS = ["", " ", "km", "deg", "%", "m/s2", "kg^0.5/m", "1/", "**", "(", ")", "9", "K"]

some_address = st.sampled_from(ADDRESSES) | st.text(max_size=8)
some_number = (
    st.floats().map(repr)
    | st.integers().map(str)
    | st.sampled_from(["1e", ".", "-", "0x1", "1_0", "١", "1e-400", "nan", "+.5"])
)
some_unit = st.lists(st.sampled_from(UNITS) | st.text(max_size=2), max_size=4)
some_quantity = st.tuples(some_number, some_unit.map("".join)).map("".join)
some_assignment = st.text() | st.tuples(some_address, some_quantity).map("=".join)

ours = hypothesis.settings(
    derandomize=True,  # the same texts in every run, so that a failure is a change
    database=None,
    deadline=None,
    max_examples=150,
    suppress_health_check=list(hypothesis.HealthCheck),
)


@pytest.fixture(scope="module")
def mission():
    """Among those that a command knows."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(ALL, "cheap", cheap.MISSION)
        yield "cheap"


def taken_or_refused(act) -> None:
    """As the command does it: a `ValueError` is a line of words, all else a traceback."""
    try:
        act()
    except ValueError as error:
        assert str(error)


@pytest.mark.slow
@ours
@hypothesis.given(st.lists(some_assignment, max_size=2))
@hypothesis.example(["vehicle.mass=1" + "0" * 400])
@hypothesis.example(["vehicle.mass=" + "(" * 50])
@hypothesis.example(["vehicle.mass=1 " + "(" * 50 + "m"])
@hypothesis.example(["vehicle.mass=1 kg**9999999"])
@hypothesis.example(["vehicle.mass=1 \ud800"])
def test_no_assignment_ends_in_a_traceback(mission, texts):
    def act():
        _, scenario, _ = chosen_scenario(mission, (), None, texts)
        values = {a: np.asarray(x) for a, x in leaves_by_address(scenario).items()}
        assert all(np.all(np.isfinite(value)) for value in values.values())
        assert values["vehicle.mass"] > 0.0
        assert abs(values["initial_state.latitude"]) <= 90.001 * degree

    taken_or_refused(act)


some_value = st.recursive(
    st.integers() | st.booleans() | st.floats() | st.text(max_size=8) | some_quantity,
    lambda inner: st.lists(inner, max_size=3),
    max_leaves=6,
)
some_key = st.sampled_from(
    [
        "law",
        "case",
        "world",
        "set",
        "dispersions",
        "address",
        "distribution",
        "mean",
        "apply",
    ]
    + ["standard_deviation", "lower", "upper", *ADDRESSES[:20]]
) | st.text(max_size=5)
some_word = st.sampled_from(
    ["normal", "uniform", "truncated_normal", "multiply", "add", "right", "all"]
    + ADDRESSES[:20]
)


def toml(value):
    """A value as TOML has it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    if isinstance(value, str):
        escaped = (
            f"\\U{ord(c):08x}" if c in '\\"' or ord(c) < 32 else c for c in value
        )
        return '"' + "".join(escaped) + '"'
    return repr(value)


some_line = (
    st.tuples(some_key, some_word | some_value).map(
        lambda pair: f"{toml(pair[0])} = {toml(pair[1])}"
    )
    | st.sampled_from(["[set]", "[dispersions.x]", "[dispersions]", "[world]"])
    | st.just("[dispersions.y]\naddress = 'vehicle.mass'\ndistribution = 'normal'")
    | st.text(max_size=12)
)
some_file = st.lists(some_line, max_size=8).map("\n".join) | st.text() | st.binary()


@ours
@hypothesis.given(some_file)
@hypothesis.example("a = " + "{b = " * 2000)
@hypothesis.example("[" + "a." * 3000 + "a]")
@hypothesis.example(normal("1e308", "1e308"))
@hypothesis.example(normal("1", "1e-320"))
@hypothesis.example(dispersion(lower="-1e308", upper="1e308"))
def test_no_file_ends_in_a_traceback(mission, tmp_path_factory, contents):
    path = tmp_path_factory.getbasetemp() / "some.toml"
    if isinstance(contents, str):
        contents = contents.encode(errors="surrogatepass")
    path.write_bytes(contents)

    def act():
        chosen, scenario, overrides = chosen_scenario(mission, (), path, None)
        _, table = dispersion_table(chosen, overrides, None)
        check_dispersions(scenario, table)

    taken_or_refused(act)


@ours
@hypothesis.given(
    st.sampled_from(ADDRESSES), st.floats(1e-3, 1e3), st.sampled_from("kMmμ")
)
def test_a_prefix_is_a_power_of_ten_for_every_leaf(address, number, prefix):
    """Whatever leaf it is given for, if its unit begins with one that takes a prefix."""
    unit = unit_of(cheap.scenario(), address)
    if unit[0] not in "mJPWK" or unit.startswith("kg"):
        return
    powers = {"k": 1e3, "M": 1e6, "m": 1e-3, "μ": 1e-6}
    first = unit.split("/")[0]
    power = int(first[-1]) if first[-1].isdigit() else 1
    expected = number * powers[prefix] ** power
    # The power, the factor and the product each round.
    assert parse_quantity(f"{number!r} {prefix}{unit}", unit) == pytest.approx(
        expected, rel=1e-14, abs=0.0
    )
