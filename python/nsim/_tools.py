"""Networks of other tools, in memory.

A graph is written as the bytes of its own format and read by the importer of files, so that one in memory gives the network that its
file gives.
"""

import io

from . import _nsim


def from_nir(graph, *, name="network", dt_ms=None, reset=None, decay=None, threshold=None):
    """A `nir.NIRGraph` as a network, as `nsim import` reads its file.

    `dt_ms` is the timestep in ms, `reset` 'zero', 'subtract' or 'subtract-later', `decay` 'euler' or 'exponential' (sinabs), `threshold`
    'strict' or 'inclusive'. `Network.notes` says by which conventions it was read. snnTorch
    (`snntorch.export_nir.export_to_nir`) and Norse (`norse.torch.to_nir`) make such graphs of their networks.
    """
    import nir

    file = io.BytesIO()
    nir.write(file, graph)
    return _nsim.from_bytes(name, file.getvalue(), dt_ms=dt_ms, reset=reset, decay=decay, threshold=threshold)


class _Subtracting:
    """A graph whose neurons subtract, though the exporter wrote v_reset: `nir.write` then leaves the field out."""

    def __init__(self, graph):
        self.graph = graph

    def to_dict(self):
        def without(node):
            return {key: without(value) for key, value in node.items() if key != "v_reset"} if isinstance(node, dict) else node

        return without(self.graph.to_dict())


def from_torch(module, sample, *, export=None, **options):
    """A `torch.nn.Module` as a network, by way of NIR; `sample` is an input of one timestep, `[batch, channels..]`.

    Modules of snnTorch and Norse are exported by their own exporters, others by `nirtorch`; `export` is another function from (module,
    sample) to a graph. `options` are those of `from_nir`. Of snnTorch, the timestep is the 0.1 ms that its exporter writes time
    constants for, and the reset is the modules', unless options say otherwise.
    """
    kinds = {type(part).__module__.split(".")[0] for part in module.modules()}
    if export is not None:
        graph = export(module, sample)
    elif "snntorch" in kinds:
        graph, found = _of_snntorch(module, sample)
        options = {**found, **options}
    elif "norse" in kinds:
        from norse.torch import to_nir

        graph = to_nir(module, sample)
    else:
        import nirtorch

        graph = nirtorch.torch_to_nir(module, {})
    return from_nir(graph, **options)


def _of_snntorch(module, sample):
    """The graph of a module of snnTorch, and what the graph does not say of it."""
    import copy

    import snntorch
    import torch
    from snntorch.export_nir import export_to_nir
    from snntorch.utils import reset

    module = copy.deepcopy(module).eval()
    layers = [part for part in module.modules() if isinstance(part, snntorch.SpikingNeuron)]
    resets = {layer.reset_mechanism for layer in layers}
    if not resets <= {"subtract", "zero"} or len(resets) > 1:
        raise ValueError(f"all layers reset alike, to 'zero' or by 'subtract', on the chip; these do so by {sorted(resets)}")
    shapes = {}
    hooks = [layer.register_forward_pre_hook(lambda one, given: shapes.update({one: given[0].shape[1:]})) for layer in layers]
    with torch.no_grad():
        module(sample)
    for hook in hooks:
        hook.remove()
    # A graph has a parameter for each neuron, where snnTorch has one for all.
    for layer in layers:
        for name in ("alpha", "beta", "threshold"):
            value = getattr(layer, name, None)
            if isinstance(value, torch.Tensor) and value.numel() == 1:
                delattr(layer, name)
                layer.register_buffer(name, value.detach().reshape(1).repeat(shapes[layer].numel()).reshape(shapes[layer]))
    reset(module)
    graph, how = export_to_nir(module, sample, ignore_dims=[0]), resets.pop()
    if how == "zero":
        return graph, {"dt_ms": 0.1, "reset": how}
    later = all(getattr(layer, "reset_delay", True) for layer in layers)
    return _Subtracting(graph), {"dt_ms": 0.1, "reset": "subtract-later" if later else "subtract"}
