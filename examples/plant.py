#!/usr/bin/env python3
"""The plant of `foreign_plant.py` by the package `retroflex`, which takes over the link, with a parameter to fit.

    pip install ./python
    retroflex evaluate --plant 'exec:python3 examples/plant.py' --arms closed
    retroflex gap compare LOG --plant 'exec:python3 examples/plant.py' --fit stiffness=0.5:2

The link itself checks what `step` returns, and keeps standard output for itself: `print` goes to standard error.
"""
import foreign_plant
from retroflex import Plant, Sample


class Tip(Plant):
    name = "python"
    imu_period_s = foreign_plant.PERIOD_S
    step_mm = foreign_plant.STEP_MM
    rest_length_mm = foreign_plant.REST_LENGTH_MM

    def __init__(self):
        self.tip = foreign_plant.Tip(seed=int(self.params.get("seed", 1)))
        # stiffer lines extend the bellows less
        self.tip.gain = [k * self.params.get("stiffness", 1.0) for k in self.tip.gain]

    def step(self, t, pistons_mm):
        imu = self.tip.step(pistons_mm)
        return Sample(imu["acc"], imu["gyr"], imu["mag"], ref=self.tip.attitude)


if __name__ == "__main__":
    Tip().run()
