"""Closed-loop control of a pneumatic endoscope tip, and diagnosis of its deviation from the model, from Python.

* `Client`: commands a running service.
* `frames`: follows it.
* `read_log`: reads bend logs and flight logs.
* `Plant`: base class of a simulator for `--plant 'exec:…'`.
* `diagnose`: says why a machine deviates from its model.

Angles are degrees, lengths mm and times s, except in the readings of an IMU, which are SI (and µT).
"""

from ._client import Client, Frame, Pose, Reach, Recording, Status, default_socket, frames
from ._diagnosis import Diagnosis, Effect, diagnose
from ._errors import BadRequest, Error, LogError, NotSettled, ProgramError, Refused, Unreachable
from ._log import read_log
from ._plant import Imu, Plant, Sample

__all__ = [
    "BadRequest", "Client", "Diagnosis", "Effect", "Error", "Frame", "Imu", "LogError", "NotSettled", "Plant", "Pose",
    "ProgramError", "Reach", "Recording", "Refused", "Sample", "Status", "Unreachable", "default_socket", "diagnose",
    "frames", "read_log",
]
