"""`jentry show`: every number, and what is dispersed."""

from jentry.units import degree


def test_show(command):
    code, printed, _ = command("show", "cheap", "--set", "vehicle.mass=900")
    assert code == 0
    numbers = printed[: printed.index("dispersions:")].splitlines()
    lines = [line for line in numbers if "vehicle.mass" in line]
    assert len(lines) == 1 and "900" in lines[0] and "kg" in lines[0]
    assert "-14.4" not in printed  # SI throughout
    assert str(round(-14.4 * degree, 9)) in printed


def test_show_a_variant_and_a_file(command, tmp_path):
    config = tmp_path / "overrides.toml"
    config.write_text('law = "steep"\n[set]\nvehicle.mass = 900')
    _, printed, _ = command("show", "cheap", "--config", config)
    assert str(round(10 * degree, 10)) in printed and "900" in printed
    _, printed, _ = command("show", "cheap", "--config", config, "--law", "right")
    assert str(round(50 * degree, 10)) in printed


def test_show_what_is_dispersed_by_each_reading(command, tmp_path):
    _, printed, _ = command("show", "cheap")
    every, mass_only = printed[printed.index("dispersions: all") :].split("mass-only")
    for name in ("mass", "density", "coefficients", "path"):
        assert f"│ {name} " in every
    assert "vehicle.lift_scale, vehicle.drag_scale" in every
    (path,) = [line for line in every.splitlines() if "│ path " in line]
    shown = f"uniform, lower {-0.1 * degree:.6g}, upper {0.1 * degree:.6g}"
    assert shown in path and " rad " in path and "added to" in path
    assert "│ mass " in mass_only and "density" not in mass_only
    _, printed, _ = command("show", "cheap", "--dispersions", "mass-only")
    assert "dispersions: mass-only" in printed and "│ density " not in printed
    config = tmp_path / "overrides.toml"
    config.write_text(
        '[dispersions]\nbase = "mass-only"\n[dispersions.nose]\n'
        'address = "vehicle.nose_radius"\ndistribution = "normal"\n'
        "mean = 1\nstandard_deviation = 0.1"
    )
    _, printed, _ = command("show", "cheap", "--config", config)
    assert "dispersions: mass-only, changed by --config" in printed
    assert "│ nose " in printed and "│ mass " in printed and "│ density " not in printed


def test_show_what_has_no_effect(command):
    """Gas and temperature serve Mach numbers, which these coefficients do not read."""
    _, printed, _ = command("show", "cheap")
    said = printed[printed.index("without effect") : printed.index("dispersions:")]
    idle = set(" ".join(said.split()).partition(": ")[2].split(", "))
    for address in ("isothermal_temperature", "gas_constant", "heat_capacity_ratio"):
        assert f"planet.atmosphere.{address}" in idle
    assert not {"vehicle.mass", "guidance.bank_angle", "target.downrange"} & idle
