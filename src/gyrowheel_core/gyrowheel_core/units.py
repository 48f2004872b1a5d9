"""SI values of the units that people read and write; everything inside is in SI."""

from __future__ import annotations

import math

RPM = 2.0 * math.pi / 60.0  #: one revolution per minute [rad/s]
DEG = math.pi / 180.0  #: one degree [rad]
