"""Sets of runs: what counts in them, and how a statistic varies from one to another."""

import numpy as np
import pytest
import xarray
from first_sets import populations

from jentry.campaign.populations import (
    Population,
    finite_flights,
    is_output,
    population,
    sets_of,
)
from jentry.flight import Outcome


def results(downrange, outcome=None, **others):
    """A stored campaign, as far as statistics read it."""
    count = len(downrange)
    outcome = np.zeros(count, np.int8) if outcome is None else np.int8(outcome)
    variables = {
        "vehicle.mass": np.full(count, 900.0),
        "outcome": outcome,
        "ended_by": np.zeros(count, np.int8),
        "downrange_error": np.asarray(downrange, float),
        **others,
    }
    columns = {name: ("run", values) for name, values in variables.items()}
    return xarray.Dataset(columns, {"run": np.arange(count)})


def largest(flown):
    return float(flown["downrange_error"].max())


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", ["downrange_error", "end_time", "peak_heat_rate"])
def test_a_flight_with_an_output_that_is_not_finite_does_not_count(value, name):
    """Whatever its outcome says: that of this one is that it reached the target."""
    spoilt = np.array([1.0, value, 3.0])
    columns = {"downrange": [1.0, 2.0, 3.0]}
    key = "downrange" if name == "downrange_error" else name
    flown = finite_flights(results(**{**columns, key: spoilt}))
    assert flown["run"].values.tolist() == [0, 2]


def test_a_flight_that_was_not_finite_does_not_count():
    """Though all that is stored of it is a number."""
    flown = finite_flights(results([1.0, 2.0, 3.0], [0, 0, Outcome.NOT_FINITE]))
    assert flown["run"].values.tolist() == [0, 1]
    others = [o for o in Outcome if o.name in {"SKIPPED_OUT", "CRASHED", "TIMED_OUT"}]
    assert len(others) == 3
    assert finite_flights(results([1.0, 2.0, 3.0], others)).sizes["run"] == 3


def test_a_history_that_ends_is_no_reason_to_leave_a_flight_out():
    kept = results([1.0, 2.0])
    kept["altitude"] = ("run", "time"), np.array([[1.0, np.nan], [1.0, 2.0]])
    assert finite_flights(kept).sizes["run"] == 2
    (one,) = sets_of(kept, 2)
    assert "altitude" not in one and "downrange_error" in one


def test_outputs_are_told_from_inputs_by_their_names():
    outputs = "end_time end_latitude peak_drag miss_distance heading_error".split()
    others = ["vehicle.peak_error", "accelerometers.lift_scale_error", "altitude"]
    assert [n for n in [*others, *outputs, "outcome", "ended_by"] if is_output(n)] == (
        outputs
    )


def test_sets_are_consecutive_runs_and_the_rest_is_in_none():
    runs = [one["run"].values.tolist() for one in sets_of(results(np.arange(8.0)), 3)]
    assert runs == [[0, 1, 2], [3, 4, 5]]
    exactly = [one["run"].values.tolist() for one in sets_of(results(np.ones(4)), 2)]
    assert exactly == [[0, 1], [2, 3]]


def test_a_flight_that_does_not_count_leaves_the_sets_where_they_are():
    """The runs behind it do not move up into its set."""
    errors = [1.0, np.nan, 3.0, 4.0, 5.0, 6.0]
    runs = [one["run"].values.tolist() for one in sets_of(results(errors), 3)]
    assert runs == [[0, 2], [3, 4, 5]]
    assert population(largest, sets_of(results(errors), 3)).values.tolist() == [
        3.0,
        6.0,
    ]


def test_a_set_without_flights_is_refused():
    errors = [1.0, 2.0, 3.0, np.nan, np.nan, 4.0]
    with pytest.raises(ValueError, match="of the runs 3 to 5, 1 are finite"):
        list(sets_of(results(errors), 3))


def test_population_by_hand():
    ours = Population(np.array([1.0, 2.0, 3.0, 6.0]))
    assert ours.mean == 3.0
    # Squares of -2, -1, 0 and 3, over three.
    assert ours.spread == pytest.approx(np.sqrt(14.0 / 3.0), rel=1e-15)
    assert ours.deviations(10.0) == pytest.approx(7.0 / np.sqrt(14.0 / 3.0), rel=1e-15)
    assert ours.deviations(-4.0) == -ours.deviations(10.0)
    assert [ours.below(x) for x in (0.5, 1.0, 2.5, 7.0)] == [0, 0, 2, 4]
    assert np.isnan(Population(np.ones(3)).deviations(2.0))


def test_spread_of_a_mean_and_growth_of_a_maximum():
    """Against what is known of draws: the spread of a mean falls with the square root
    of the size of a set, and a maximum of uniform draws has the mean n / (n + 1).
    """
    sets = 100
    draws = np.random.default_rng(5).uniform(size=sets * 40)

    def mean(flown):
        return float(flown["downrange_error"].mean())

    for size in (10, 40):
        of = results(draws[: sets * size])
        # The standard error of a spread is a share 1 / sqrt(2 n) of it: five of these.
        close = 5.0 / np.sqrt(2.0 * sets)
        expected = np.sqrt(1.0 / 12.0 / size)
        assert population(mean, sets_of(of, size)).spread == pytest.approx(
            expected, rel=close
        )
        top = population(largest, sets_of(of, size))
        close = 5.0 * top.spread / np.sqrt(sets)
        assert top.mean == pytest.approx(size / (size + 1.0), abs=close)


# What the benchmark saves.


def test_the_first_runs_are_of_the_first_set_whatever_follows():
    errors = np.arange(25.0)
    errors[[2, 20, 21]] = np.nan
    (first,) = {
        tuple(populations.first_runs_of(results(errors[:n]))["run"].values)
        for n in (8, 25)
    }
    assert first == (0, 1, 3, 4, 5, 6, 7)


def test_what_is_saved_of_a_mission_is_read_and_takes_the_place_of_what_was(
    monkeypatch, tmp_path
):
    monkeypatch.setattr(populations, "SAVED", tmp_path / "saved.csv")
    row, other = ("newton", "normal", "median"), ("stored", "normal", "median")
    for value in (1.0, 2.0):
        saved = populations.Statistic(value / 3.0, np.array([value, 7.0]), "2026-11-28")
        populations.save("cav-h", {row: saved})
        populations.save("rlv", {other: saved})
    read = populations.statistics()
    assert list(read) == [("cav-h", *row), ("rlv", *other)]
    for found in read.values():
        assert found.first_runs == pytest.approx(2.0 / 3.0, rel=1e-9)
        assert found.date == "2026-11-28"
        assert found.sets.tolist() == [2.0, 7.0]
    assert {key: sets.tolist() for key, sets in populations.saved().items()} == {
        key: found.sets.tolist() for key, found in read.items()
    }


def test_every_statistic_is_saved_of_first_runs_and_of_each_set():
    rows = {
        (mission, *row, heading)
        for mission, all_rows in populations.ROWS.items()
        for row in all_rows
        for heading in populations.statistics_of(mission, row[0])
    }
    saved = populations.statistics()
    assert saved.keys() == rows
    for found in saved.values():
        assert found.sets.shape == (populations.SETS,)
        assert np.isfinite(found.first_runs) and np.all(np.isfinite(found.sets))


def test_a_statistic_that_was_saved_twice_is_refused(tmp_path, monkeypatch):
    row = "mars,law,everything,maximum,2026-11-30,1.0,2.0\n"
    for rows, found in ((row, 1), (row + row.replace("law", "other"), 2), (2 * row, 0)):
        (tmp_path / "saved.csv").write_text(rows)
        monkeypatch.setattr(populations, "SAVED", tmp_path / "saved.csv")
        if found:
            assert len(populations.statistics()) == found
            continue
        with pytest.raises(ValueError, match="two rows mars, law, everything, maximum"):
            populations.statistics()
