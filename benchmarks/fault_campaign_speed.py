"""How long a campaign takes, in units of what NumPy needs to draw its noise, and where the time goes.

Run it with::

    .venv/bin/python benchmarks/fault_campaign_speed.py [--runs 10000] [--samples 5000] [--workers 2]

A plant with 4 states, one input and two outputs, six noises; a Kalman filter with a norm threshold, faults named by
direction. One scenario: each run is simulated and watched without a fault, and with it. The noise is drawn once more by
itself, by the same generators, before and after.
"""

from __future__ import annotations

import argparse
import cProfile
import pstats
import resource
import time

import numpy as np

import residua as rs

SIZE = 0.5


def monitor() -> rs.Monitor:
    """Return the monitor of the plant with four states."""
    A = [[0.9, 0.1, 0, 0], [0, 0.85, 0.1, 0], [0, 0, 0.8, 0.1], [0, 0, 0, 0.7]]
    plant = rs.Plant(A, [[0], [0], [0], [0.5]], [[1, 0, 0, 0], [0, 0, 1, 0]], dt=1)
    plant = plant.with_sensor_faults().with_actuator_faults().with_noise(process=1e-4, measurement=1e-2)
    return rs.Monitor(rs.design.kalman_filter(plant), test=rs.decide.NormThreshold(false_alarm_rate=0.001))


def noise_alone(runs: int, samples: int, channels: int) -> float:
    """Return the seconds that NumPy needs for the noise of so many runs."""
    begin = time.process_time()
    for run in range(runs):
        np.random.default_rng(np.random.SeedSequence(1, spawn_key=(run, 0))).standard_normal((samples, channels))
    return time.process_time() - begin


def main() -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=400)
    parser.add_argument("--samples", type=int, default=5000)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--profile", action="store_true", help="where the time goes, in one process")
    chosen = parser.parse_args()
    watched = monitor()
    scenario = rs.validate.Scenario("y1 sensor", rs.validate.step(at=0.6 * chosen.samples), size=SIZE)

    def run(workers: int) -> rs.validate.Campaign:
        return rs.validate.campaign(
            watched, scenario, runs=chosen.runs, samples=chosen.samples, seed=1, workers=workers, progress=False
        )

    if chosen.profile:
        profile = cProfile.Profile()
        profile.runcall(run, 1)
        pstats.Stats(profile).sort_stats("tottime").print_stats(18)
        return
    noise = noise_alone(chosen.runs, chosen.samples, 6)
    if chosen.workers > 1:  # the workers start with the first campaign
        rs.validate.campaign(watched, runs=100, samples=100, workers=chosen.workers, progress=False)
    begin, busy = time.perf_counter(), time.process_time()
    made = run(chosen.workers)
    taken, busy = time.perf_counter() - begin, time.process_time() - busy
    noise = (noise + noise_alone(chosen.runs, chosen.samples, 6)) / 2
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(made)
    print(f"\nnoise alone: {noise:.2f} s of one core")
    print(f"the campaign, {chosen.workers} workers: {taken:.2f} s by the clock, {taken / noise:.1f} times the noise")
    if chosen.workers == 1:
        each = 1e9 * busy / (chosen.runs * chosen.samples)
        print(f"{busy:.2f} s of one core, {busy / noise:.1f} times; {each:.0f} ns for each sample of a run")
    print(f"memory of this process: at most {memory:.2f} GB")


if __name__ == "__main__":
    main()
