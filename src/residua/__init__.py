"""Model-based fault detection and isolation.

From a plant model and a list of faults to residual generators, alarms and the name of the faulty component.
"""

from residua.facade import hand_on

__version__ = "0.1.0"

hand_on(__name__)
