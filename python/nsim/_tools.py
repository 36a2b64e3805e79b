"""Networks of other tools, in memory.

A graph is written as the bytes of its own format and read by the importer of files, so a graph in memory and its file give equal
networks.
"""

import io
import warnings

from . import _neurons, _nsim, _torch


def from_nir(graph, *, name="network", dt_ms=None, reset=None, decay=None, threshold=None, decision=None, tool=None, check=None):
    """A `nir.NIRGraph` as a network, as `nsim import` reads its file.

    `dt_ms` is the timestep in ms, `reset` 'zero', 'subtract' or 'subtract-later', `decay` 'euler' or 'exponential' (sinabs), `threshold`
    'strict' or 'inclusive', `decision` 'Spikes', 'GreatestV', 'SumOfV' or 'LastV'. `Network.notes` has the conventions of its import. snnTorch
    (`snntorch.export_nir.export_to_nir`) and Norse (`norse.torch.to_nir`) make such graphs of their networks.
    `tool` has the conventions of 'snntorch', 'norse' and so on (`nsim._nsim.TOOLS`), which single options change. `check` is a pair: spikes
    of the input `[samples, channels.., T]` and those of the output that the tool gave, `[samples, neurons, T]`. A network that
    differs is refused, with what each tool's conventions would give.
    """
    if not hasattr(graph, "to_dict"):
        message = f"from_nir needs a nir.NIRGraph, but graph is a {type(graph).__name__}"
        raise _torch.refusal(message, "read a file with nsim.load(path), and an object of the package nir with from_nir", "usage")
    import nir

    file = io.BytesIO()
    nir.write(file, graph)
    options = {"dt_ms": dt_ms, "reset": reset, "decay": decay, "threshold": threshold, "decision": decision, "tool": tool}
    read = lambda **more: _nsim.from_bytes(name, file.getvalue(), **{**options, **more})
    return read() if check is None else _checked(read, check)


def _checked(read, check):
    """The network that `read` gives, if it spikes as in the pair `check`."""
    spikes, recorded = check
    samples = _torch.recording(recorded)
    try:
        network = read()
        differing, said = _nsim.check_recording(network, spikes, samples)
        if not differing:
            return network
    except _nsim.Error as error:
        if error.code != "import.option":
            raise
        said = str(error)
    rows = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for tool in _nsim.TOOLS:
            try:
                rows.append((*_nsim.check_recording(read(tool=tool), spikes, samples), tool))
            except _nsim.Error:
                continue
    tools = "; ".join(f"with tool={tool!r}: {said.split(';')[0]}" for _, said, tool in sorted(rows))
    raise _torch.refusal(said, tools or "no tool's conventions apply to the graph", "check.differs")


def from_torch(module, sample, *, export=None, **options):
    """A `torch.nn.Module` as a network; `sample` is an input of one timestep, `[batch, channels..]`.

    A network of snnTorch, Norse, spikingjelly, sinabs or Rockpool is read from its modules and compared with them on random samples: a
    network that differs is refused. The sample has no axis of time, also where modules take all timesteps in one call. `check` are spikes `[samples, channels.., T]` for one more comparison, or a pair with the recorded output, `output` names the layer that decides, by default
    the first that forward() returns. Options replace the timestep (of the neurons of Norse and Rockpool; 0.1 ms for snnTorch and
    spikingjelly, as in their own exporters; 1 ms for sinabs) and the reset and threshold test of the modules. `export` is a function from (module, sample) to a graph of NIR, for another tool, without a comparison.
    `options` are as in `from_nir`.
    """
    module = _torch.read(module, sample)
    kinds = {_neurons.package_of(part) for part in _neurons.parts_of(module)}
    if export is None and kinds & set(_neurons.TOOLS):
        return _torch.network_of(module, sample, **options)
    if export is None:
        message = f"the module ({_torch.kind_of(module)}) has no neurons of {', '.join(_neurons.TOOLS.values())}"
        help = "put neurons after its layers, such as snntorch.Leaky; for another tool, give its exporter: export="
        raise _torch.refusal(message, help)
    try:
        graph = export(module, sample)
    except _nsim.Error:
        raise
    except Exception as error:
        message = f"the exporter to NIR stopped: {type(error).__name__}: {error}"
        raise _torch.refusal(message, f"installed versions: {_versions()}; {WITHOUT_EXPORTER}") from error
    return from_nir(graph, **options)


WITHOUT_EXPORTER = "build a nir.NIRGraph for nsim.from_nir (docs/tutorials/from-pytorch.md#without-a-trained-network)"


def _versions():
    """Installed versions of the packages of an export."""
    from importlib.metadata import PackageNotFoundError, version

    def one(name):
        try:
            return f"{name} {version(name)}"
        except PackageNotFoundError:
            return f"no {name}"

    return ", ".join(map(one, ("torch", "nir", "nirtorch", "norse", "sinabs")))
