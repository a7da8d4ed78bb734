"""Print what stamps that are late or stray, and slopes, cost the fused yaw, learnt and not.

PYTHONPATH=tests python -m tools.tables [late] [straying] [leaning]
"""

import argparse
import math

import numpy as np
from test_fusion_faults import with_stray_stamps
from test_image_timing import swinging
from test_tilt import on_slope

from compass import YawIncrement
from fusion import FusionConfig, YawFusion


def late():
    """RMS yaw error, deg, of three robots that swing to and fro, and the mean of error squared over variance."""
    known = FusionConfig(camera_delay_sigma=0.0, compass_timing_factor=1.0)
    variants = {
        "taken for right": known,
        "stray learnt": FusionConfig(camera_delay_sigma=0.0),
        "both learnt": FusionConfig(),
    }
    for name, config in variants.items():
        for delay in (0.0, 0.02, 0.05, 0.1):
            errors, normalised = [], []
            for seed in range(3):
                samples, t, yaw = swinging(delay, seed)
                fusion = YawFusion(config)
                for sample in samples:
                    fusion.add(sample)
                    if isinstance(sample, YawIncrement):
                        estimate = fusion.estimate()
                        errors.append(estimate.yaw - float(np.interp(sample.t_ns * 1e-9, t, yaw)))
                        normalised.append(errors[-1] ** 2 / estimate.yaw_variance)
            rms = math.degrees(np.sqrt(np.mean(np.square(errors))))
            print(f"late by {1e3 * delay:3.0f} ms, {name}: {rms:.2f} ({np.mean(normalised):.1f})", flush=True)


def straying():
    """Worst end of ten drives of half a minute, deg, and the mean of error squared over variance there."""
    for name, config in (("5 ms assumed", FusionConfig(compass_timing_factor=1.0)), ("learnt", FusionConfig())):
        for stray in (0.001, 0.005, 0.01, 0.015, 0.03):
            errors, normalised = [], []
            for rate, seed in ((rate, seed) for rate in (0.4, 1.0) for seed in range(5)):
                fusion = YawFusion(config)
                for sample in with_stray_stamps(stray, rate, seed):
                    fusion.add(sample)
                estimate = fusion.estimate()
                errors.append(estimate.yaw - rate * estimate.t_ns * 1e-9)
                normalised.append(errors[-1] ** 2 / estimate.yaw_variance)
            worst = math.degrees(np.abs(errors).max())
            print(f"straying by {1e3 * stray:2.0f} ms, {name}: {worst:.2f} ({np.mean(normalised):.1f})", flush=True)


def leaning():
    """RMS and worst yaw error, deg, of three robots on a slope, and the mean of error squared over variance."""
    drawn = FusionConfig(compass_error_time=1.0)  # as `robot_drive` says
    for name, told in (("unknown", False), ("known", True)):
        for lean in (0.0, 10.0, 20.0, 30.0):
            errors, normalised = [], []
            for drive in (on_slope(seed, lean, told=told) for seed in range(3)):
                fusion = YawFusion(drawn)
                for sample in drive.samples:
                    fusion.add(sample)
                    if isinstance(sample, YawIncrement):
                        estimate = fusion.estimate()
                        errors.append(drive.error(estimate))
                        normalised.append(errors[-1] ** 2 / estimate.yaw_variance)
            rms, worst = (math.degrees(value) for value in (np.sqrt(np.mean(np.square(errors))), np.abs(errors).max()))
            print(f"leaning by {lean:2.0f} deg, {name}: {rms:.2f} {worst:.2f} ({np.mean(normalised):.1f})", flush=True)


TABLES = {"late": late, "straying": straying, "leaning": leaning}


def main():
    """Print the tables asked for, or all."""
    parser = argparse.ArgumentParser("tables", description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("tables", nargs="*", metavar="TABLE", help=f"of {', '.join(TABLES)}; all")
    for name in parser.parse_args().tables or TABLES:
        TABLES[name]()


if __name__ == "__main__":
    main()
