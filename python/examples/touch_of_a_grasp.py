"""Simulates grasps of a bottle at several forces, renders what the gels see and predicts stability.

    python python/examples/touch_of_a_grasp.py

Prints one line per stopping force: outcome, peak traction, contact, prediction.
"""

from typing import Literal

import numpy as np

import gripcast as gc

FORCES_N = (5.0, 20.0)
SIDES: tuple[Literal["left", "right"], ...] = ("left", "right")


def main() -> None:
    bottle = gc.Object(gc.Mesh.builtin("bottle"), mass_kg=0.2, friction=0.5)
    sensor = gc.SensorProfile("gelsight-mini")
    # The built-in classifier also needs a colour image; the heuristic is content with touch.
    predictor = gc.Predictor("baseline-contact")
    cases = [gc.GraspCase(bottle, gel="coarse", stop_force_n=force, fields="stages") for force in FORCES_N]
    for force, result in zip(FORCES_N, gc.simulate_batch(cases)):
        assert result.fields is not None
        closed = result.fields.stage.index("adjustment")
        peak_kpa = 1e-3 * float(-result.fields.traction_pa[closed, ..., 2].min())
        before = [gc.render_tactile(result, side=side, moment="initial", profile=sensor) for side in SIDES]
        after = [gc.render_tactile(result, side=side, moment="grasp", profile=sensor) for side in SIDES]
        prediction = predictor.predict((before[0].image, before[1].image), (after[0].image, after[1].image))
        contact = np.mean([image.contact_fraction for image in after])
        print(
            f"{force:5.1f} N: {result.outcome}, {peak_kpa:.0f} kPa at most, {100 * contact:.0f} % of the gels in "
            f"contact, predicted {prediction.predicted}"
        )


if __name__ == "__main__":
    main()
