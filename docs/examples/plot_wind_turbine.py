"""
A wind turbine, subsystem by subsystem
======================================

A wind turbine of 4.8 MW is a well-known test for fault diagnosis (Odgaard, Stoustrup and Kinnaert, *Fault-tolerant control
of wind turbines: a benchmark model*, IEEE Transactions on Control Systems Technology 21, 2013). It has nine faults: sensors
that stick or read too much, a pitch actuator whose oil leaks or has air in it, a converter with an offset, a drive train
that loses a little more to friction.

The turbine as a whole is not linear, and nobody measures the torque that the wind exerts. Its parts are: each blade's pitch
system, the converter, and the drive train, for which the torque of the wind is a disturbance that residuals are
decoupled from. So each part gets a plant and a monitor of its own, and what the wind does drops out.

The turbine is simulated here, by the parameters of the benchmark, and with a simpler wind, rotor, and controller.
"""

import matplotlib.pyplot as plt
import numpy as np

import residua as rs

# %%
# The parts
# ---------
# Hundred samples a second. The noise is that of the benchmark's sensors.
DT = 0.01
NATURAL, DAMPING = 11.11, 0.6  # rad/s; of a pitch system
ROTOR, GENERATOR, GEAR = 55e6, 390.0, 95.0  # kg m2, kg m2, ratio
TWIST, TWIST_DAMPING, EFFICIENCY = 2.7e9, 775.49, 0.97  # N m/rad, N m s/rad
FRICTION = 7.11, 45.6  # N m s/rad, of rotor and generator
CONVERTER, POWER_SHARE = 50.0, 0.98  # rad/s; efficiency of the generator
NOISE = {"angle": 0.2, "rotor": 0.025, "generator": 0.05, "torque": 90.0, "power": 1000.0}


def pitch(blade):
    """Return the pitch system of a blade: from its reference to two sensors of its angle."""
    plant = rs.Plant(
        [[0, 1], [-(NATURAL**2), -2 * DAMPING * NATURAL]], [[0], [NATURAL**2]], [[1, 0], [1, 0]],
        name=f"pitch of blade {blade}", inputs=[f"pitch {blade}"], outputs=[f"angle {blade}a", f"angle {blade}b"],
        units=dict.fromkeys([f"pitch {blade}", f"angle {blade}a", f"angle {blade}b"], "deg"),
    )  # fmt: skip
    plant = plant.with_sensor_faults().with_actuator_faults()
    return plant.discretize(DT).with_noise(process=1e-8, measurement=NOISE["angle"] ** 2)


def converter():
    """Return the converter: from the torque asked for to the torque, by its sensor and by power over speed."""
    plant = rs.Plant(
        [[-CONVERTER]], [[CONVERTER]], [[1], [1]],
        name="converter", inputs=["converter"], outputs=["torque", "power by speed"],
        units=dict.fromkeys(["converter", "torque", "power by speed"], "N m"),
    )  # fmt: skip
    plant = plant.with_sensor_faults().with_actuator_faults()
    return plant.discretize(DT).with_noise(process=1.0, measurement=[NOISE["torque"] ** 2, 12.0**2])


def drive_train():
    """Return the drive train: the generator's torque is known, that of the wind is a disturbance."""
    stiff, damped = TWIST, TWIST_DAMPING
    plant = rs.Plant(
        [
            [-(damped + FRICTION[0]) / ROTOR, damped / GEAR / ROTOR, -stiff / ROTOR],
            [EFFICIENCY * damped / GEAR / GENERATOR, -(EFFICIENCY * damped / GEAR**2 + FRICTION[1]) / GENERATOR,
             EFFICIENCY * stiff / GEAR / GENERATOR],
            [1, -1 / GEAR, 0],
        ],
        [[0], [-1 / GENERATOR], [0]], [[1, 0, 0], [1, 0, 0], [0, 1, 0], [0, 1, 0]],
        name="drive train", inputs=["torque"], states=["rotor speed", "generator speed", "twist"],
        outputs=["rotor speed a", "rotor speed b", "generator speed a", "generator speed b"],
    )  # fmt: skip
    plant = plant.with_disturbances({"torque of the wind": [1 / ROTOR, 0, 0]}).with_sensor_faults()
    plant = plant.with_faults({"friction": [0, -1 / GENERATOR, 0]})
    measured = [NOISE["rotor"] ** 2] * 2 + [NOISE["generator"] ** 2] * 2
    return plant.discretize(DT).with_noise(process=1e-10, measurement=measured)


# %%
# A turbine to watch
# ------------------
# The wind wanders about 15 m/s; the controller holds the speed by pitch where it is above the nominal one, and by torque below.
# The nine faults come one after another, half a minute each. A sensor that fails also misleads the controller.
FAULTS = [
    ("angle 1a sensor", "sticks at 5 degrees"),
    ("angle 2b sensor", "reads 1.2 times the angle"),
    ("angle 3a sensor", "sticks at 10 degrees"),
    ("rotor speed a sensor", "sticks at 1.4 rad/s"),
    ("rotor speed b sensor and generator speed a sensor", "read 1.1 and 0.9 times the speed"),
    ("pitch 2 actuator", "loses pressure: half as fast"),
    ("pitch 3 actuator", "has air in its oil: a third as fast"),
    ("converter actuator", "gives 100 N m more than is asked for"),
    ("friction", "takes 5 % more of the torque"),
]
SPACE, LASTS = 60.0, 30.0
BEGINS = SPACE * np.arange(1, 1 + len(FAULTS))


def torque_share(ratio, angle):
    """Return the rotor's torque coefficient: the curve of a power coefficient that is much used in textbooks."""
    inner = 1 / (1 / (ratio + 0.08 * angle) - 0.035 / (angle**3 + 1))
    return max(0.22 * (116 / inner - 0.4 * angle - 5) * np.exp(-12.5 / inner), 0.0) / ratio


def simulate(seconds, seed, faulty):
    """Return inputs and outputs of the parts: pitch and torque references, and all sensors."""
    rng = np.random.default_rng(seed)
    count = round(seconds / DT)
    gusts = 0.45 * np.sqrt(DT) * rng.standard_normal(count)
    deviations = (
        [NOISE["rotor"]] * 2 + [NOISE["generator"]] * 2 + [NOISE["angle"]] * 6 + [NOISE["torque"], NOISE["power"]]
    )
    noise = rng.standard_normal((count, 12)) * deviations
    begins = BEGINS if faulty else BEGINS + np.inf
    best = 0.5 * 1.225 * np.pi * 57.5**5 * EFFICIENCY * 0.44 / (GEAR * 8) ** 3  # torque by squared speed, below nominal
    rotor, speed, torque, held, gust = 1.7, 162.0, 3e4, 5.0, 0.0
    twist = torque * GEAR / (TWIST * EFFICIENCY)
    angle, rate = np.full(3, held), np.zeros(3)
    references, sensors = np.empty((count, 4)), np.empty((count, 12))
    for k in range(count):
        time = k * DT
        on = (begins <= time) & (time < begins + LASTS)
        read = (
            np.array([rotor, rotor, speed, speed, *np.repeat(angle, 2), torque, POWER_SHARE * speed * torque])
            + noise[k]
        )
        if on[:5].any():
            read[[4, 8, 0]] = np.where(on[[0, 2, 3]], [5.0, 10.0, 1.4], read[[4, 8, 0]])
            read[7] *= 1.2 if on[1] else 1.0
            read[1:3] *= [1.1, 0.9] if on[4] else 1.0
        excess = (read[2] + read[3]) / 2 - 162.0
        held = min(max(held + DT * excess, 0.0), 25.0)
        asked = min(max(held + 4.0 * max(excess, -10.0), 0.0), 30.0)
        wanted = min(best * (excess + 162.0) ** 2, 4.8e6 / (POWER_SHARE * max(excess + 162.0, 60.0)))
        references[k], sensors[k] = [asked, asked, asked, wanted], read

        natural, damping = np.full(3, NATURAL), np.full(3, DAMPING)
        natural[1:], damping[1:] = np.where(on[5:7], [5.73, 3.42], NATURAL), np.where(on[5:7], [0.45, 0.9], DAMPING)
        rate = rate + DT * (natural**2 * (asked - angle) - 2 * damping * natural * rate)
        angle = angle + DT * rate
        torque += DT * CONVERTER * (wanted + 100.0 * on[7] - torque)
        gust += gusts[k] - DT * gust / 8
        wind = max(15.0 + 2 * np.sin(time / 30) + gust, 4.0)
        share = torque_share(min(max(rotor * 57.5 / wind, 1.0), 25.0), angle.mean())
        driving = 0.5 * 1.225 * np.pi * 57.5**3 * share * wind**2
        for _ in range(2):
            passed = TWIST * twist + TWIST_DAMPING * (rotor - speed / GEAR)
            rotor += DT / 2 * (driving - passed - FRICTION[0] * rotor) / ROTOR
            speed += (
                DT / 2 * ((0.92 if on[8] else EFFICIENCY) * passed / GEAR - FRICTION[1] * speed - torque) / GENERATOR
            )
            twist += DT / 2 * (rotor - speed / GEAR)
    by_speed = sensors[:, 11] / (POWER_SHARE * np.median(sensors[:, 2:4], axis=1))
    return references, np.column_stack([sensors[:, :11], by_speed])


healthy, faulty = simulate(1500.0, 0, faulty=False), simulate(SPACE * (len(FAULTS) + 1), 1, faulty=True)

# %%
# What can be told apart
# ----------------------
# Before any data. A pitch system's two sensors and its actuator can be told from each other. The drive train's sensors too;
# but *a constant friction leaves no lasting trace*, as the torque of the wind could do the same, and is not known.
print(rs.diagnosability(pitch(1)), end="\n\n")
print(rs.diagnosability(drive_train()))

# %%
# One monitor for each part
# -------------------------
# Each part has a structured bank: residuals that each fault fires in a pattern of its own. Thresholds come from 25 minutes
# without a fault; the test is the one that a monitor has without an option.
PARTS = {
    "pitch 1": (pitch(1), [0], [4, 5]),
    "pitch 2": (pitch(2), [1], [6, 7]),
    "pitch 3": (pitch(3), [2], [8, 9]),
    "converter": (converter(), [3], [10, 11]),
    "drive train": (drive_train(), None, [0, 1, 2, 3]),
}


def signals(recording, inputs, outputs):
    """Return what a part gets and what is measured of it; the drive train gets the torque that is measured."""
    references, sensors = recording
    return (sensors[:, [10]] if inputs is None else references[:, inputs]), sensors[:, outputs]


diagnoses = {}
for part, (plant, inputs, outputs) in PARTS.items():
    bank = rs.design.structured_bank(plant, rs.coding.choose(plant))
    monitor = rs.Monitor(bank).fit(*signals(healthy, inputs, outputs))
    diagnoses[part] = monitor.run(*signals(faulty, inputs, outputs))

# %%
# What was found
# --------------
# For each fault: the alarms of its half minute, the first of them, and the names that they give.
WHERE = [
    "pitch 1",
    "pitch 2",
    "pitch 3",
    "drive train",
    "drive train",
    "pitch 2",
    "pitch 3",
    "converter",
    "drive train",
]


def names(alarm):
    """Return what an alarm is put down to, as text."""
    return " or ".join(" and ".join(group) for group in alarm.named) or "several faults, or not known"


print(f"{'fault':<51}{'raised after':>12}  {'in alarm':>8}  named, by the longest alarm")
for (fault, _), part, begin in zip(FAULTS, WHERE, BEGINS, strict=True):
    diagnosis = diagnoses[part]
    seen = [a for a in diagnosis.alarms if begin <= a.raised < begin + LASTS]
    longest = max(seen, key=lambda a: a.samples, default=None)
    after = f"{seen[0].raised - begin:10.2f} s" if seen else "-"
    share = diagnosis.alarm[round(begin / DT) : round((begin + LASTS) / DT)].mean()
    print(f"{fault:<51}{after:>12}  {share:>8.0%}  {names(longest) if longest else '-'}")

OWN = {part: [t for t, where in zip(BEGINS, WHERE, strict=True) if where == part] for part in PARTS}
OWN["converter"].append(BEGINS[4])  # its second measurement is power over the speed that is read
false = [
    alarm
    for part, diagnosis in diagnoses.items()
    for alarm in diagnosis.alarms
    if not any(begin <= alarm.raised < begin + LASTS + 1.0 for begin in OWN[part])
]
print(f"\nfalse alarms in ten minutes of five monitors: {len(false)}, the longest of", end=" ")
print(f"{max((alarm.samples for alarm in false), default=0) * DT:.2f} s")

# %%
# Sensors that stick and the converter are known within a few samples. A sensor that reads too much, and the two pitch actuators,
# are seen while the blades are turned, and not while they stand still at zero: a slow actuator that is asked for nothing does
# nothing wrong. Two sensors that fail at once are no pattern of one fault, and the bank says so. Power over speed is a second
# measurement of the torque, so a speed sensor that fails raises an alarm of the converter's monitor as well. The friction is
# not seen, as was said before any data.
figure, axes = plt.subplots(figsize=(9, 4), layout="constrained")
for begin, (fault, _), part in zip(BEGINS, FAULTS, WHERE, strict=True):
    row = list(PARTS).index(part)
    axes.broken_barh([(begin, LASTS)], (row - 0.45, 0.9), color="0.85")
    below = part == "drive train"
    place = row + (0.47 if below else -0.47)
    axes.annotate(
        fault.replace(" sensor", "").replace(" and ", ",\n"),
        (begin, place),
        fontsize=7,
        va="top" if below else "bottom",
    )
for row, diagnosis in enumerate(diagnoses.values()):
    for named, color in ((True, "C3"), (False, "C1")):
        bars = [(a.raised, a.samples * DT) for a in diagnosis.alarms if bool(a.named) is named]
        axes.broken_barh(bars, (row - 0.1, 0.4), color=color, label="_" if row else "named" if named else "not named")
axes.set(
    ylim=(-0.9, 5), yticks=range(len(PARTS)), yticklabels=PARTS, xlabel="time in s", title="Faults (grey) and alarms"
)
axes.invert_yaxis()
axes.legend(loc="upper right", ncols=2)
assert all(
    any(a.named == ((fault,),) for a in diagnoses[part].alarms)
    for (fault, _), part in zip(FAULTS, WHERE, strict=True)
    if fault not in {FAULTS[4][0], "friction"}
)
