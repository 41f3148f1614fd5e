"""Cases whose data are spoilt: that is to be said, and nothing else."""

from collections.abc import Iterator

import imucal
from gap.case import Answer, Case, generator
from gap.noise import paper
from gap.scene import Scene
from gap.sizes import DEG


def faults(runs: int) -> Iterator[Case]:
    for index in range(runs):
        random = generator("fault", index)
        clipped_gyro = random.uniform(60.0, 120.0) * DEG
        clipped_accel = random.uniform(12.9, 13.4)
        yield _fault("gyro_saturation", index, "A'", clipped_gyro)
        # No range ends below 1.3 g: it is a fast hand that brings an accelerometer there.
        shaken = Scene(
            effects=(imucal.EffectValues("accel_saturation", [clipped_accel]),),
            motion=imucal.Tumble(0, poses=46, hold_s=5.0, move_s=0.5, translation_mm=300.0),
            unit=paper(gyroscope={"lsb": None, "bits": None}),
        )
        clipped = Answer(verdicts=("data_fault",), fault="accel_saturation")
        yield Case("fault", "accel_saturation", index, shaken, clipped)
        yield _fault("samples_missing", index, "A'", random.uniform(0.005, 0.02))
        yield _fault("samples_duplicated", index, "A'", random.uniform(0.005, 0.02))
        stamps = Scene(stamp_jitter_s=random.uniform(1e-3, 3e-3))
        yield Case(
            "fault",
            "clock_irregular",
            index,
            stamps,
            Answer(verdicts=("data_fault",), fault="clock_irregular"),
        )
        yield _fault("mount_slip", index, "C", random.uniform(1.0, 3.0) * DEG)
        tremor = random.uniform(1e-3, 3e-3)
        tumble = imucal.Tumble(0, translation_mm=0.0)
        # A hand's tremor is a part of the model (docs/model.md, 27): where it takes it up nothing is missing.
        trembling = Scene("A'", (imucal.EffectValues("rest_not_still", [tremor]),), motion=tumble)
        taken_up = Answer(verdicts=("data_fault", "nothing_missing"), fault="rest_not_still")
        yield Case("fault", "rest_not_still", index, trembling, taken_up)
    # The stamps are even and the instants are not: only the noise inside moves shows this fault, so it gets
    # more cases than the others.
    for index in range(6 * runs):
        jitter_s = generator("even stamps", index).uniform(1e-3, 3e-3)
        instants = Scene(effects=(imucal.EffectValues("clock_irregular", [jitter_s]),))
        said = Answer(verdicts=("data_fault",), fault="clock_irregular")
        yield Case("fault", "clock_irregular, even stamps", index, instants, said)


def _fault(name: str, index: int, kind: str, value: float) -> Case:
    scene = Scene(kind, (imucal.EffectValues(name, [value]),))
    return Case("fault", name, index, scene, Answer(verdicts=("data_fault",), fault=name))
