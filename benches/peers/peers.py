"""The peers of the accuracy row with their settings.

`tune.py` chose them on units that are not scored. In the nominal condition the peers run with the settings that are best there;
under the other conditions, which no controller is told, with those that are best over several.
"""

from __future__ import annotations

from collections.abc import Callable

from controllers import Broyden, Controller, Mpc, OpenLoop, SlowPi

# imufusion's filter: gain, then the thresholds in degrees beyond which acceleration and field are rejected
ESTIMATOR = (0.5, 10.0, 10.0)
# where the motors disturb the field, the peers do better without a magnetometer
WITHOUT_FIELD = (0.5, 10.0, None)

Makers = dict[str, Callable[[], Controller]]

NOMINAL: Makers = {
    "open loop": OpenLoop,
    "Python stack": lambda: SlowPi(ki=4.0, kp=0.0, band_mm=2.0, wait_s=0.1),
    "Broyden": lambda: Broyden(gain_per_s=4.0, forgetting=0.3, band_mm=5.0, wait_s=0.1),
    "MPC": lambda: Mpc(observer=0.1, effort=1e-5, band_mm=0.2),
}
ROBUST: Makers = {
    "open loop": OpenLoop,
    "Python stack": lambda: SlowPi(ki=4.0, kp=0.3, band_mm=2.0, wait_s=0.3),
    "Broyden": lambda: Broyden(gain_per_s=3.0, forgetting=1.0, band_mm=0.2, wait_s=0.3),
    "MPC": lambda: Mpc(observer=0.05, effort=1e-5, band_mm=0.5),
}
