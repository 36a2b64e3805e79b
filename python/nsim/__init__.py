"""Maps trained spiking networks onto simulated Loihi cores, runs them bit for bit, and reports energy and latency.

>>> import nsim
>>> mapping = nsim.load("vtsnn-slip").map()
>>> print(mapping.run().accuracy, mapping.energy().energy_uj)
"""

from ._nsim import Energy, Error, Mapping, Network, Run, __version__, load

__all__ = ["Energy", "Error", "Mapping", "Network", "Run", "__version__", "load"]
