"""Command lines that are refused, with the word that each message has."""


# What is written, and a part of the message that refuses it.

STATE = "initial_state."

SET = {
    # no quantity
    "vehicle.mass": "write ADDRESS=VALUE",
    "": "write ADDRESS=VALUE",
    "vehicle.mass=": "vehicle.mass: '' is not a number",
    "vehicle.mass=heavy": "'heavy' is not a number",
    "vehicle.mass=1,5": "'1,5' is not a number",
    "vehicle.mass=1 2": "'1 2' is not a number",
    "vehicle.mass==900": "'=900' is not a number",
    "vehicle.mass=900 900kg": "is not a number",
    "vehicle.mass=1 kg**9**9**9": "is not a number",
    "vehicle.mass=[900]": "is not a number",
    "vehicle.mass=900 stone": "'stone'",
    "vehicle.mass=900 KG": "'KG'",
    "vehicle.mass=900 kg/": "not known",
    # no leaf
    "=3": "no leaf ''",
    "vehicle=900": "no leaf 'vehicle'",
    "vehicle.mas=900": "nearest: vehicle.mass",
    "vehicle.mass.x=900": "nearest: vehicle.mass",
    "Vehicle.Mass=900": "no leaf 'Vehicle.Mass'",
    "dynamics=1": "no leaf 'dynamics'",
    "termination.time_limit=100": "no leaf 'termination.time_limit'",
    "termination.conditions.0.velocity=1": "no leaf",
    "guidance.__class__=1": "no leaf",
    # another dimension
    "vehicle.mass=900km": "[length]",
    "vehicle.mass=900 %": "without a dimension",
    "vehicle.mass=9 N": "[mass] * [length] / [time] ** 2",
    "vehicle.reference_area=16m": "a number in m2",
    "vehicle.nose_radius=1 m2": "[length] ** 2",
    "vehicle.lift_scale=1m": "a plain number",
    "planet.density_scale=1deg": "a plain number",
    "planet.density_scale=1 kg/m3": "a plain number",
    "planet.rotation_rate=1 rad": "a number in rad/s",
    "planet.rotation_rate=1 Hz": "a number in rad/s",
    "planet.radius=3397 deg": "[angle]",
    "planet.gravity.gravitational_parameter=4e4 km2": "m3/s2",
    "planet.atmosphere.scale_height=9 s": "[time]",
    "planet.atmosphere.surface_density=1 kg/m2": "kg/m3",
    "planet.atmosphere.gas_constant=287 J/kg": "J/(kg K)",
    "planet.heating_coefficient=1 kg/m": "kg^0.5/m",
    STATE + "altitude=126deg": "a number in m",
    STATE + "longitude=1km": "a number in rad",
    STATE + "latitude=1 %": "a number in rad",
    STATE + "velocity=5km": "a number in m/s",
    STATE + "flight_path_angle=-14.2 m": "a number in rad",
    STATE + "heading=90 deg/s": "a number in rad",
    "termination.conditions.velocity.velocity=503m": "a number in m/s",
    "target.altitude=10 km/s": "a number in m",
    "guidance.bank_angle=3 %": "a number in rad",
    # degrees forgotten
    STATE + "flight_path_angle=-14.2": "did you mean -14.2deg?",
    STATE + "heading=90": "did you mean 90deg?",
    STATE + "longitude=137.4": "did you mean 137.4deg?",
    STATE + "latitude=2": "did you mean 2deg?",
    STATE + "latitude=-4.5": "did you mean -4.5deg?",
    "guidance.bank_angle=50": "did you mean 50deg?",
    "vehicle.trim_angle_of_attack=11": "did you mean 11deg?",
    # another unit than SI forgotten
    STATE + "velocity=6.75": "Write the unit, 6.75km/s or 6.75m/s",
    STATE + "velocity=6750 km": "a number in m/s",
    STATE + "altitude=126.1": "did you mean 126.1km?",
    "vehicle.mass=0.9": "did you mean 0.9t?",
    "planet.gravity.gravitational_parameter=42828.3": "did you mean 42828.3km3/s2?",
    # out of range
    "vehicle.mass=0": "vehicle.mass is 0 kg: it must be greater than zero",
    "vehicle.mass=-1 kg": "greater than zero",
    "vehicle.mass=nan": "vehicle.mass is nan: it must be a finite number",
    "vehicle.mass=inf": "a finite number",
    "vehicle.mass=1e999": "a finite number",
    "vehicle.mass=1e308 t": "a finite number",
    "vehicle.drag_scale=-0.0": "greater than zero",
    "vehicle.nose_radius=-1ft": "greater than zero",
    "vehicle.aerodynamics.drag_coefficient=0": "greater than zero",
    "planet.density_scale=-5 %": "greater than zero",
    "planet.radius=0": "greater than zero",
    STATE + "altitude=-1": "altitude is -1 m: it must be zero or more",
    STATE + "altitude=-10000km": "zero or more",
    STATE + "latitude=91deg": "between -90 and 90 deg",
    STATE + "latitude=190deg": "between -90 and 90 deg",
    STATE + "latitude=-90.1deg": "between -90 and 90 deg",
    STATE + "flight_path_angle=91deg": "between -90 and 90 deg",
    STATE + "flight_path_angle=-1.6": "between -90 and 90 deg",
    STATE + "heading=361deg": "between -360 and 360 deg",
    STATE + "longitude=-400deg": "between -360 and 360 deg",
    STATE + "velocity=0": "greater than zero",
    STATE + "velocity=-6750": "greater than zero",
    "guidance.bank_angle=7 rad": "between -360 and 360 deg",
    "termination.conditions.velocity.velocity=-503": "greater than zero",
}

UNIFORM = {
    "address": '"vehicle.mass"',
    "distribution": '"uniform"',
    "lower": "900",
    "upper": "1000",
}


def dispersion(name="x", **changes):
    """A table of one, in which something is wrong."""
    entries = {k: v for k, v in (UNIFORM | changes).items() if v is not None}
    lines = [f"{key} = {value}" for key, value in entries.items()]
    return "\n".join([f'[dispersions."{name}"]', *lines, ""])


def normal(mean, width, **changes):
    numbers = {"mean": mean, "standard_deviation": width, "lower": None, "upper": None}
    return dispersion(distribution='"normal"', **(numbers | changes))


CONFIG = {
    "law = ": "no valid TOML",
    "[set]\n[set]": "no valid TOML",
    "set = " + "[" * 5000: "nested too deep",
    "set." + ".".join("a" * 5000) + " = 1": "nested too deep",
    "set.a = " + "9" * 5000: "no valid TOML",
    "lwa = 'a'": "nearest: law",
    "[sets]": "unknown key 'sets'",
    "law = 3": "law is 3: it must be a name",
    "law = ''": "no law ''",
    "law = 'left'": "no law 'left'",
    "law = ['right']": "it must be a name",
    "[law]\nname = 'right'": "it must be a name",
    "dispersions = 3": "dispersions is 3",
    "dispersions = []": "it must be a name",
    "[dispersions]": "[dispersions] is empty",
    "set = 3": "write a table, [set]",
    "set = []": "write a table, [set]",
    "[set]\nvehicle.mass = true": "vehicle.mass is True: it must be a number",
    "[set]\nvehicle.mass = 1979-05-27": "it must be a number",
    "[set]\nvehicle.mass = 'much'": "'much' is not a number",
    "[set]\nvehicle.mass = '900 km'": "[length]",
    "[set]\nvehicle.mass = nan": "vehicle.mass is nan",
    "[set]\nvehicle.mass = 1" + "0" * 400: "vehicle.mass: ",
    "[set]\nvehicle.mass = [900]": "vehicle.mass has shape ()",
    "[set]\nvehicle.mass = []": "vehicle.mass has shape ()",
    "[set]\nvehicle = 900": "no leaf 'vehicle'",
    "[set]\nvehicle.mass = 9\n'vehicle.mass' = 9": "vehicle.mass is given twice",
    "[set]\ninitial_state.latitude = 12": "did you mean 12deg?",
    "[set]\ninitial_state.heading = ['5', [1, 2]]": "rows of unequal length",
    "[dispersions]\nx = 3": "write a table, [dispersions.x]",
    dispersion(distribution=None): "dispersions.x.distribution is None",
    dispersion(distribution='"unifrom"'): "choose from normal, uniform",
    dispersion(upper=None): "[dispersions.x] lacks upper",
    dispersion(uper=3): "nearest: upper",
    dispersion(upper='"much"'): "dispersions.x.upper: 'much' is not a number",
    dispersion(upper='"1 km"'): "dispersions.x.upper: '1 km' is [length]",
    dispersion(upper="true"): "dispersions.x.upper is True",
    dispersion(address=None): "lacks address",
    dispersion(address="[]"): "dispersions.x.address is []",
    dispersion(address="3"): "dispersions.x.address is 3",
    dispersion(address='"vehicle"'): "no leaf 'vehicle'",
    dispersion(address='"vehicle.mas"'): "nearest: vehicle.mass",
    dispersion(apply='"plus"'): "apply is 'plus'",
    dispersion(apply='"multiply"', upper='"1 kg"'): "a plain number",
    dispersion(address='["vehicle.mass", "vehicle.drag_scale"]'): "different units",
    dispersion(address='"initial_state.heading"', lower="89"): "did you mean 89deg?",
}
"""By what is written: these are refused by every command that reads a configuration."""

ALONE = "[dispersions]\nreplace = true\n"

DISPERSED = {
    dispersion(lower="1000", upper="900"): "lower is 1000 kg: it must be below upper",
    dispersion(lower="900", upper="900"): "it must be below upper",
    dispersion(upper="inf"): "dispersions.x.upper is inf",
    normal("1000", "0"): "standard_deviation is 0",
    normal("1000", "-5"): "standard_deviation is -5",
    normal("nan", "5"): "dispersions.x.mean is nan",
    normal("990", "0.1", lower="993.9", upper="994").replace(
        "normal", "truncated_normal"
    ): "dispersions.x.mean is 39 standard deviations",
    dispersion(
        address='["vehicle.mass", "vehicle.mass"]'
    ): "reaches vehicle.mass twice",
    normal("1", "0.1", address='"planet.rotation_rate"', apply='"multiply"'): (
        "a factor on planet.rotation_rate, which is zero"
    ),
    normal("1", "0.1", address='"vehicle.trim_angle_of_attack"'): "has no effect",
    normal("1", "0.1", address='"planet.atmosphere.gas_constant"'): "has no effect",
    dispersion("a") + dispersion("b"): "'b' replaces vehicle.mass",
    dispersion("plumless") + dispersion("buckeroo", apply='"add"'): "CRC-32",
}

INPUTS = {
    b"": "empty; expected a line with the names of the columns",
    b"vehicle.mass\n\n": "0 rows of numbers below",
    b"\xff\xfe": "decode",
    b"vehicle.mass\nheavy\n": "heavy",
    b"vehicle.mass\n900 kg\n": "900 kg",
    b"vehicle.mas\n900\n": "nearest: vehicle.mass",
    b"vehicle.mass,vehicle.mass\n900,900\n": "'vehicle.mass' appears more than once",
    b"vehicle.mass,planet.density_scale\n900\n": "line 2: 1 values; expected 2",
    b"vehicle.mass\n0\n": "vehicle.mass is 0 kg",
    b"vehicle.mass\nnan\n": "line 2: vehicle.mass is 'nan'; expected a finite",
    b"initial_state.latitude\n91\n": "initial_state.latitude is 91 rad",
    b"initial_state.flight_path_angle\n-14.2\n": "did you mean -14.2deg?",
    b"initial_state.altitude\n-1\n": "zero or more",
}

FLIGHT = {
    "--step 0": "step is 0.0 s: it must be positive",
    "--step -1": "step is -1.0 s",
    "--step nan": "step is nan s",
    "--step inf": "step is inf s: it must be positive and finite",
    "--step 1e-320": "step is 1e-320 s",
    "--step 1e-9": "more than 1e+09 steps",
    "--history 0": "history is 0.0 s: the interval must be positive",
    "--history -1": "history is -1.0 s",
    "--history nan": "history is nan s",
    "--history inf": "history is inf s",
    "--history 1e-9": "history is 1e-09 s: of a flight of 300 s",
}

CAMPAIGN = {
    "--runs 0": "no runs to fly",
    "--runs -2": "runs is -2",
    "--runs 4294967297": "2^32 - 1",
    "--runs 1000000000000000000000000": "runs is 1000000000000000000000000",
    "--runs many": "--runs",
    "--runs 1.5": "--runs",
    "--seed 9223372036854775808": "the seed is 9223372036854775808",
    "--seed 18446744073709551616": "the seed is 18446744073709551616",
    "--seed -9223372036854775809": "the seed is -9223372036854775809",
    "--seed 1e3": "--seed",
    "--dispersions none": "choose from all, mass-only",
    "--inputs nowhere.csv": "nowhere.csv",
    "--workers two": "--workers",
    "--figure": "--figure",
}

TUNE = {
    "--loss least": "loss is 'least'",
    "--optimizer newton": "optimizer is 'newton'",
    "--optimizer=": "optimizer is ''",
    "--set planet.density_scale=1.1": "every run draws it from the dispersion",
    "--gains guidance.bank": "no leaf 'guidance.bank'",
    "--gains=": "no leaf ''",
    "--gains vehicle.mass": "the dispersion 'mass' moves it",
    "--of range=1km": "no miss or path constraint 'range'",
    "--of altitude=-1km": "the scale must be greater than zero",
    "--of altitude=inf": "the scale must be greater than zero",
    "--of altitude=5kg": "a number in m",
    "--of altitude=5km --of altitude=6km": "altitude is given twice",
    "--of velocity": "write velocity=SCALE",
    "--of heading=50": "did you mean 50deg?",
    "--bounds guidance.bank_angle=1": "write ADDRESS=LOW:HIGH",
    "--bounds guidance.bank_angle=2:3": "on both sides of its value",
    "--bounds guidance.bank_angle=1km:2km": "a number in rad",
    "--bounds guidance.bank_angle=10:90": "did you mean 10deg?",
    "--bounds guidance.bank=0:1": "no leaf 'guidance.bank'",
    "--bounds vehicle.mass=1:a": "'a' is not a number",
    "--smooth": "AbstractSwitching",
    "--runs 1": "runs is 1",
    "--steps 0": "steps is 0",
    "--held-out 1": "held_out is 1",
    "--patience 0": "patience is 0",
    "--learning-rate 0": "--learning-rate is 0.0",
    "--learning-rate nan": "--learning-rate is nan",
    "--seed 9223372036854775808": "the seed is 9223372036854775808",
    "--step inf": "step is inf s",
}

OTHERS = {
    "": "Usage",
    "flie cheap": "flie",
    "list chaep": "no mission 'chaep'",
    "show": "Missing argument",
    "fly": "Missing argument",
    "show cheap mars": "mars",
    "show cheap --laws right": "--laws",
    "show cheap --config nowhere.toml": "nowhere.toml",
    "show cheap --config .": "directory",
    "fly cheap --step one": "--step",
    "show cheap --set vehicle.mass=1 --set vehicle.mass=2": "vehicle.mass is given twice",
    "train mars-drag-tracking": "no networks to train: see mars-range-tracking, cav-h",
    "train cav-h --flights 3": "--flights is 3",
    "train cav-h --again 99": "--again is 99",
    "train cav-h --iterations 0": "--iterations is 0",
    "train cav-h --seed 9223372036854775808": "the seed is 9223372036854775808",
    "sensitivity cheap --scale 0": "scale is 0: it must be greater than zero",
    "sensitivity cheap --scale 1 --scale -1": "scale is -1",
    "sensitivity cheap --scale inf": "scale is inf",
    "sensitivity cheap --scale nan": "scale is nan",
    "sensitivity cheap --wrt vehicle.mas": "nearest: vehicle.mass",
    "sensitivity cheap --wrt=": "no leaf ''",
    "sensitivity cheap --seed 9223372036854775808": "the seed is",
    "sensitivity cheap --runs 1": "runs is 1",
}
for _name in ("show", "fly", "monte-carlo", "tune", "train", "sensitivity"):
    OTHERS[f"{_name} chaep"] = "no mission 'chaep'; nearest"
    OTHERS[f"{_name} mars\n"] = "no mission"
for _name in ("show", "fly", "monte-carlo", "tune", "sensitivity"):
    OTHERS[f"{_name} cheap --law left"] = "no law 'left': choose from right"
    OTHERS[f"{_name} cheap --law="] = "no law ''"
for _name in ("monte-carlo", "tune", "sensitivity"):
    OTHERS[f"{_name} cheap --dispersions="] = "no dispersions ''"

COMMANDS = (
    [(["show", "cheap", f"--set={text}"], {}, word) for text, word in SET.items()]
    + [
        (["show", "cheap", "--config", "x.toml"], {"x.toml": text}, word)
        for text, word in CONFIG.items()
    ]
    + [
        (["monte-carlo", "cheap", "--config", "x.toml"], {"x.toml": ALONE + text}, word)
        for text, word in DISPERSED.items()
    ]
    + [
        (["monte-carlo", "cheap", "--inputs", "x.csv"], {"x.csv": text}, word)
        for text, word in INPUTS.items()
    ]
    + [
        ([command, "cheap", *words.split()], {}, word)
        for command in ("fly", "monte-carlo")
        for words, word in FLIGHT.items()
    ]
    + [
        (["monte-carlo", "cheap", *words.split()], {}, w)
        for words, w in CAMPAIGN.items()
    ]
    + [
        (["tune", "cheap", "--gains", "guidance.bank_angle", *words.split()], {}, word)
        for words, word in TUNE.items()
        if "--gains" not in words
    ]
    + [
        (["tune", "cheap", *words.split()], {}, word)
        for words, word in TUNE.items()
        if "--gains" in words
    ]
    + [(words.split(" ") if words else [], {}, word) for words, word in OTHERS.items()]
)
GIVEN = {"x.csv": b"vehicle.mass\n900\n950\n"}
COMMANDS += [
    (["monte-carlo", "cheap", "--inputs", "x.csv", *words.split()], GIVEN | more, word)
    for words, more, word in (
        ("--runs 3", {}, "--runs is 3, and x.csv has 2"),
        ("--runs 0", {}, "no runs to fly"),
        ("--dispersions all", {}, "--inputs takes the place of dispersions"),
        ("--dispersions=", {}, "--inputs takes the place"),
        ("--config x.toml", {"x.toml": dispersion()}, "--inputs takes the place"),
        ("--config x.toml", {"x.toml": "dispersions = 'all'"}, "--inputs takes the pl"),
    )
]
