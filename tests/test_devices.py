"""Batches on a GPU, for which a core of the processor stands in the tests."""

import dataclasses
import functools
import json
from collections import OrderedDict

import cheap
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jentry
from jentry import _devices
from jentry._devices import PAYS, Gpu, choose, kind_for
from jentry.campaign import (
    CampaignError,
    batch,
    monte_carlo,
    on_gpu,
    open_campaign,
    run_campaign,
)
from jentry.campaign.parts import read_manifest
from jentry.guidance import BankProfile
from jentry.guidance.open_loop import vertical_lift_command


RUNS = 40


@pytest.fixture(autouse=True)
def chosen_again(monkeypatch):
    monkeypatch.setattr(_devices, "_CHOSEN", None)
    monkeypatch.setattr(on_gpu, "_FITS", {})
    monkeypatch.setattr(on_gpu, "_KERNELS", OrderedDict())


@pytest.fixture
def stand_in(monkeypatch):
    """A core in place of a GPU; its kernels are compiled by XLA."""
    device = Gpu(jax.devices("cpu")[0], "xla")
    monkeypatch.setattr(_devices, "gpu", lambda: device)
    return device


class Sorting(BankProfile):
    """A law with an operation that a kernel does not know."""

    def to_the_right(self, time, measurement, memory):
        command, _ = super().to_the_right(time, measurement, memory)
        less = command.cos_bank - measurement.state.velocity
        cosines = jnp.stack([command.cos_bank, less])
        return vertical_lift_command(
            jnp.sort(cosines)[1], command.angle_of_attack
        ), None


def flown(scenario=None, **options):
    scenario = cheap.scenario() if scenario is None else scenario
    table = cheap.dispersions()
    return monte_carlo(scenario, table, 3, RUNS, solver=cheap.SOLVER, **options)


def assert_same_flights(found, expected, rtol=1e-11):
    """Rounding apart; misses are differences of numbers of planetary size."""
    np.testing.assert_array_equal(found.flights.outcome, expected.flights.outcome)
    leaves = [
        jax.tree.leaves((c.inputs, c.flights, c.misses)) for c in (found, expected)
    ]
    for a, b in zip(*leaves, strict=True):
        assert a.dtype == b.dtype and a.shape == b.shape
        np.testing.assert_allclose(a, b, rtol=rtol, atol=1e-6)


def test_a_gpu_flies_the_same_flights_and_the_campaign_says_so(stand_in):
    expected = flown()
    assert expected.flown_on == ""
    choose("gpu")
    found = flown()
    assert found.flown_on == f"{stand_in.name}, each flight in one kernel"
    assert_same_flights(found, expected)


def test_where_a_kernel_does_not_know_an_operation_xla_flies_and_it_is_said(stand_in):
    scenario = cheap.at_trim()
    scenario = dataclasses.replace(
        scenario, guidance=Sorting(scenario.guidance.cos_bank)
    )
    expected = flown(scenario)
    choose("gpu")
    found = flown(scenario)
    assert "by XLA, since a flight" in found.flown_on
    assert "test_devices.py" in found.flown_on and "'sort'" in found.flown_on
    assert_same_flights(found, expected)


def test_a_kernel_that_flies_otherwise_is_not_taken(stand_in, monkeypatch):
    """A small defect looks like a result: so the processor flies the first runs too."""
    made = on_gpu.kernel_of

    def wrong(*given, **options):
        kernel = made(*given, **options)
        off = lambda x: x * (1.0 + 3e-6) if x.dtype == float else x
        return lambda runs: jax.tree.map(off, kernel(runs))

    monkeypatch.setattr(on_gpu, "kernel_of", wrong)
    expected = flown()
    choose("gpu")
    found = flown()
    assert "100% of the first flights of its kernel are others" in found.flown_on
    assert_same_flights(found, expected)


def test_a_second_campaign_finds_the_kernel_of_the_first(stand_in, monkeypatch):
    """And not that of another number, another structure or another input."""
    made, makers = [], on_gpu.kernel_of
    monkeypatch.setattr(
        on_gpu, "kernel_of", lambda *g, **o: made.append(1) or makers(*g, **o)
    )
    choose("gpu")
    first = flown()
    assert_same_flights(flown(), first, rtol=0.0)
    assert len(made) == 1
    scenario, lens = cheap.scenario(), lambda s: s.vehicle.mass
    heavier = eqx.tree_at(lens, scenario, 1.001 * scenario.vehicle.mass)
    assert np.all(flown(heavier).flights.time != first.flights.time)
    assert len(made) == 2
    table = dict(list(cheap.dispersions().items())[1:])
    given = scenario, table, 3, RUNS
    monte_carlo(*given, solver=cheap.SOLVER)
    assert len(made) == 3
    monte_carlo(*given, solver=dataclasses.replace(cheap.SOLVER, step=0.9))
    assert len(made) == 4
    flown()
    assert len(made) == 4


def test_of_many_kernels_those_that_flew_last_are_kept(stand_in, monkeypatch):
    monkeypatch.setattr(on_gpu, "_MOST_KERNELS", 2)
    monkeypatch.setattr(
        on_gpu, "kernel_of", lambda *given, form: functools.partial(len)
    )
    make = lambda number: on_gpu._kernel(stand_in, len, number, {})
    one, two = make(1.0), make(2.0)
    assert make(1.0) is one
    make(3.0)
    assert make(1.0) is one and make(2.0) is not two


def test_a_run_differs_by_more_than_rounding():
    """Of the largest number of its kind; NaN and infinity are equal to themselves."""
    expected = {"x": np.array([1.0, -2.0, 0.0, np.nan, np.inf]), "n": np.arange(5)}
    off = np.array([1.9e-6, 2.1e-6, 0.0, 0.0, 0.0])
    found = {"x": expected["x"] + off, "n": np.array([0, 1, 2, 3, 5])}
    other = on_gpu.differing(found, expected)
    np.testing.assert_array_equal(other, [False, True, False, False, True])


def test_a_miss_near_zero_is_rounding_of_the_large_numbers_that_it_comes_from():
    """An end that a range to go decides has a downrange miss of 1e-9 m, of 1e6 m flown."""
    expected = {"downrange": np.array([8e-11, 8e-10, 8e-10])}
    found = {"downrange": np.array([-9.3e-10, 0.9e-6, 1.1e-6])}
    other = on_gpu.differing(found, expected)
    np.testing.assert_array_equal(other, [False, False, True])


def test_histories_are_flown_by_xla(stand_in):
    expected = flown(history=20.0)
    choose("gpu")
    found = flown(history=20.0)
    assert "has a history, which a kernel does not store" in found.flown_on
    assert_same_flights(found, expected)


def test_batches_are_halved_until_they_fit_into_memory(stand_in, monkeypatch):
    """No run is lost or flown twice, and the size that fits is kept."""
    sizes, fly = [], on_gpu._fly

    def small(gpu, function, shared, runs):
        sizes.append(len(runs))
        if len(runs) > 128:
            raise jax.errors.JaxRuntimeError("RESOURCE_EXHAUSTED: out of memory")
        return fly(gpu, function, shared, runs)

    monkeypatch.setattr(on_gpu, "_fly", small)
    runs = np.arange(300.0)
    double = lambda shared, run: shared * run
    for _ in range(2):
        found = on_gpu.by_xla(stand_in, double, jnp.asarray(2.0), runs)
        np.testing.assert_array_equal(found, 2.0 * runs)
    assert sizes == [512, 256, *6 * [128]]


def test_no_memory_for_the_smallest_batch_is_an_error(stand_in, monkeypatch):
    def none(*given):
        raise jax.errors.JaxRuntimeError("RESOURCE_EXHAUSTED: out of memory")

    monkeypatch.setattr(on_gpu, "_fly", none)
    with pytest.raises(jax.errors.JaxRuntimeError, match="RESOURCE_EXHAUSTED"):
        on_gpu.by_xla(stand_in, lambda s, r: r, jnp.asarray(1.0), np.arange(100.0))


def of_counted(shared, runs, counts):
    return jnp.sum(jnp.where(counts, shared * runs, 0.0)), jnp.sum(counts)


def of_run(shared, run):
    return shared * run


def test_sums_and_values_on_a_gpu_are_those_of_the_processor(stand_in):
    runs, shared = np.linspace(0.0, 1.0, 1000), jnp.asarray(3.0)
    expected = batch.sum_over_runs(of_counted, shared, runs)
    values = batch.over_runs(of_run, shared, runs)
    choose("gpu")
    total, count = batch.sum_over_runs(of_counted, shared, runs)
    assert count == expected[1] == 1000
    np.testing.assert_allclose(total, expected[0], rtol=1e-13)
    np.testing.assert_array_equal(batch.over_runs(of_run, shared, runs), values)


def test_a_gpu_is_taken_for_many_runs_or_as_chosen(stand_in):
    assert kind_for(PAYS - 1) == "cpu"
    assert kind_for(PAYS) == "gpu"
    choose("cpu")
    assert kind_for(10 * PAYS) == "cpu"
    choose("gpu")
    assert kind_for(1) == "gpu"


def test_without_a_gpu_the_processor_flies_all(monkeypatch):
    monkeypatch.setattr(_devices, "gpu", lambda: None)
    assert kind_for(10**9) == "cpu"


@pytest.mark.parametrize(
    "plugin, why",
    [(False, r"pip install 'jentry\[cuda\]'"), (True, "nvidia-smi")],
    ids=["no-plugin", "no-gpu"],
)
def test_a_gpu_that_is_not_there_is_refused(monkeypatch, plugin, why):
    monkeypatch.setattr(_devices, "gpu", lambda: None)
    monkeypatch.setattr(_devices, "has_plugin", lambda: plugin)
    with pytest.raises(RuntimeError, match=why):
        choose("gpu")
    assert _devices._CHOSEN is None


def test_another_word_is_refused():
    with pytest.raises(ValueError, match="device is 'tpu': it must be 'cpu' or 'gpu'"):
        choose("tpu")


def test_a_process_without_a_gpu_says_what_to_install(command):
    """The options reach `setup`, which the fixture replaces."""
    given = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("jentry._setup.setup", lambda *how, **o: given.append(o))
        command("monte-carlo", "cheap", "--runs", 2, "--device", "cpu", "--no-figures")
        for name in ("sensitivity", "compare", "tune"):
            command(name, "cheap", "--device", "gpu", "--runs", 0)
    assert [o["device"] for o in given] == ["cpu", "gpu", "gpu", "gpu"]
    code, _, error = command("monte-carlo", "cheap", "--device", "tpu")
    assert code == 2 and "tpu" in error


def test_a_campaign_says_on_what_it_was_flown(stand_in, tmp_path):
    choose("gpu")
    cheap.campaign(tmp_path, 3)
    assert read_manifest(tmp_path)["device"] == "gpu"
    assert open_campaign(tmp_path).attrs["flown_on"].endswith("in one kernel")


def test_a_campaign_on_the_processor_is_stored_as_before(tmp_path):
    cheap.campaign(tmp_path, 3)
    assert "device" not in read_manifest(tmp_path)
    assert "flown_on" not in open_campaign(tmp_path).attrs


def test_another_device_does_not_go_on_with_a_campaign(stand_in, tmp_path):
    cheap.campaign(tmp_path / "cpu", 3)
    choose("gpu")
    with pytest.raises(CampaignError, match="flown on the processor, and a GPU would"):
        cheap.campaign(tmp_path / "cpu", 5)
    cheap.campaign(tmp_path / "gpu", 3)
    choose("cpu")
    with pytest.raises(CampaignError, match="give --device gpu"):
        cheap.campaign(tmp_path / "gpu", 5)
    choose("gpu")
    cheap.campaign(tmp_path / "gpu", 5)
    assert open_campaign(tmp_path / "gpu").sizes["run"] == 5


def test_the_rest_of_a_large_campaign_is_flown_on_its_device(
    stand_in, tmp_path, monkeypatch
):
    """By the rule the device follows from all runs, and not from those that are missing."""
    monkeypatch.setattr(_devices, "PAYS", 6)
    cheap.campaign(tmp_path, 6)
    for part in tmp_path.glob("runs-*.nc"):
        part.unlink()
    seen = []

    def stopped(stored):
        seen.append(stored)

    run_campaign(
        tmp_path,
        cheap.scenario(),
        cheap.dispersions(),
        cheap.SEED,
        6,
        solver=cheap.SOLVER,
        report=stopped,
    )
    assert json.loads((tmp_path / "campaign.json").read_text())["device"] == "gpu"
    assert seen == [0, 6]


def test_setup_takes_the_device():
    with pytest.raises(ValueError, match="device is 'tpu'"):
        jentry.setup(jax.local_device_count("cpu"), cache=False, device="tpu")
