"""Networks of other tools, in memory.

A graph is written as the bytes of its own format and read by the importer of files, so that one in memory gives the network that its
file gives.
"""

import io

from . import _nsim


def from_nir(graph, *, name="network", dt_ms=None, reset=None, threshold=None, input_shape=None):
    """A `nir.NIRGraph` as a network, as `nsim import` reads its file.

    `dt_ms` is the timestep in ms, `reset` 'zero' or 'subtract', `threshold` 'strict' or 'inclusive', `input_shape`
    (channels, height, width). `Network.notes` says by which conventions it was read. snnTorch
    (`snntorch.export_nir.export_to_nir`) and Norse (`norse.torch.to_nir`) make such graphs of their networks.
    """
    import nir

    file = io.BytesIO()
    nir.write(file, graph)
    options = {"dt_ms": dt_ms, "reset": reset, "threshold": threshold, "input_shape": input_shape}
    return _nsim.from_bytes(name, file.getvalue(), **options)
