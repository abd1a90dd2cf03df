"""The peers of the accuracy row with their settings.

`tune.py` chose the settings on units that are not scored, nominal and under conditions.
"""

from __future__ import annotations

from collections.abc import Callable

from controllers import Broyden, Controller, Mpc, OpenLoop, SlowPi

# gain, then the thresholds in degrees beyond which acceleration and field are rejected
ESTIMATOR = (0.5, 10.0, 10.0)

PEERS: dict[str, Callable[[], Controller]] = {
    "open loop": OpenLoop,
    "Python stack": lambda: SlowPi(kp=0.1, ki=4.0, band_mm=2.0, wait_s=0.3),
    "Broyden": lambda: Broyden(gain_per_s=2.0, forgetting=0.6, band_mm=0.2, wait_s=0.2),
    "MPC": lambda: Mpc(observer=0.05, effort=1e-7, band_mm=0.5),
}
