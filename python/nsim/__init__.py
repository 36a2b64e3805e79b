"""Maps trained spiking networks onto simulated Loihi cores, runs them bit for bit, and reports energy and latency.

>>> import nsim
>>> mapping = nsim.load("vtsnn-slip").map()
>>> print(mapping.run().accuracy, mapping.energy().energy_uj)
"""

from ._nsim import (
    Agreement,
    Conversion,
    Energy,
    Error,
    Events,
    Mapping,
    Network,
    Population,
    Run,
    Session,
    Snapshot,
    Training,
    Values,
    Warning,
    __version__,
    load,
    train,
)
from ._learning import Pes, Rule, Signal
from ._sweep import Table, sweep
from ._tools import from_nir, from_torch

__all__ = [
    "Agreement",
    "Conversion",
    "Energy",
    "Error",
    "Events",
    "Mapping",
    "Network",
    "Pes",
    "Population",
    "Rule",
    "Run",
    "Session",
    "Signal",
    "Snapshot",
    "Table",
    "Training",
    "Values",
    "Warning",
    "__version__",
    "from_nir",
    "from_torch",
    "load",
    "sweep",
    "train",
]
