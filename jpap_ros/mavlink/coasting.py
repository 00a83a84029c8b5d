"""Moving targets that may be the last one: what an autopilot makes of it by itself leads no farther than was checked.

After its last target, ArduPilot goes on with that target's velocity for GUID_TIMEOUT, and then has to brake. Sent as it
is, the velocity would carry an aircraft past the end of its leg, where nobody has looked for others.
https://ardupilot.org/dev/docs/copter-commands-in-guided-mode.html
"""

from __future__ import annotations

import math
from dataclasses import replace

from jpap_ros.fleet.traffic import Setpoint

#: Rate at which autopilots make good an error of position [1/s]: PX4's MPC_XY_P is 0.95; ArduPilot closes in at the
#: ratio of PSC_JERK_XY and WPNAV_ACCEL, 2. In between, both are off by about half of the lead below, at most.
POSITION_GAIN = 1.5


def coasting(setpoint: Setpoint, keeps_s: float) -> Setpoint:
    """Return a setpoint that an aircraft follows as closely, and that coasts no farther than the end of its leg.

    Parameters
    ----------
    setpoint : Setpoint
    keeps_s : float
        For how long at the last target's velocity it runs on, braking included; more than 1 / POSITION_GAIN [s].

    Notes
    -----
    With speed v, d metres before the end, it gives the velocity w and the lead (v - w) / POSITION_GAIN, so that the
    error of position makes up for the velocity that is missing; w is the largest with lead + w * keeps_s <= d. All
    aircraft of a convoy have v and d in proportion to their legs, so that the lead and w are too: those that
    coast stay on their common clock.
    """
    speed = math.hypot(*setpoint.velocity)
    lead_s = 1.0 / POSITION_GAIN
    slower = max(0.0, (setpoint.ahead_m - speed * lead_s) / (keeps_s - lead_s))
    if slower >= speed:
        return setpoint
    lead_m = min((speed - slower) * lead_s, setpoint.ahead_m)
    east, north, up = (v / speed for v in setpoint.velocity)
    x, y, z = setpoint.position
    return replace(
        setpoint,
        position=(x + lead_m * east, y + lead_m * north, z + lead_m * up),
        velocity=(slower * east, slower * north, slower * up),
        ahead_m=setpoint.ahead_m - lead_m,
    )
