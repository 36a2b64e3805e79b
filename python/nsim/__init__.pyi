from os import PathLike
from typing import Any, Mapping as Dictionary, Optional, Sequence, Union

import numpy as np
from numpy.typing import NDArray

Path = Union[str, "PathLike[str]"]
Array = NDArray[Any]
Sources = Union[str, Sequence[str], None]
Channels = Union[Sequence[int], NDArray[np.integer[Any]], NDArray[np.bool_]]
Spikes = Union[Array, Events, Dictionary[str, Union[Array, Events]], str, Sequence[str], None]

__version__: str

class Error(Exception):
    """A failure of nsim."""

    code: str
    """A stable name: 'model.unknown', 'input.shape', 'map.does-not-fit', 'usage', .."""
    place: Optional[str]
    """FILE:LINE:COLUMN, or FILE."""
    help: Optional[str]
    """The remedy."""
    reasons: list[dict[str, Any]]
    """Every problem; where a network does not fit, the `reasons` of `nsim map --format json`."""

class Warning(UserWarning):
    """A warning of a run, such as a population that never spikes."""

class Events:
    """Spikes as rows (sample, step, channel), or one sample as records with the fields t, x, y and p."""

    def __init__(
        self, events: Array, *, steps: Optional[int] = None, samples: Optional[int] = None, unit: Optional[str] = None
    ) -> None: ...
    def __len__(self) -> int: ...

def load(model: Path, **options: Any) -> Network:
    """Loads a model file or a shipped model. Options complete the file of another tool: `dt_ms`, `neuron`, `reset`, `decay`,
    `threshold`, `decision`, `input_shape`."""

def from_nir(
    graph: Any,
    *,
    name: str = "network",
    dt_ms: Optional[float] = None,
    reset: Optional[str] = None,
    decay: Optional[str] = None,
    threshold: Optional[str] = None,
    decision: Optional[str] = None,
    tool: Optional[str] = None,
    check: Any = None,
) -> Network:
    """A `nir.NIRGraph` as a network, as `nsim import` reads its file; `dt_ms` is the timestep in ms, `tool` the one
    whose conventions hold, `check` a pair of input and output spikes that the tool gave."""

def from_torch(module: Any, sample: Any, *, export: Any = None, **options: Any) -> Network:
    """A `torch.nn.Module` as a network; `sample` is an input of one timestep, `[batch, channels..]`. A network
    of snnTorch, Norse, spikingjelly, sinabs or Rockpool that would spike differently is refused; modules of other tools need `export`, their exporter to NIR."""

def sweep(
    sweep: Path, *, threads: Optional[int] = None, client: Any = None, parts: Optional[int] = None
) -> Table:
    """Runs every variant of a sweep file or text, on threads or on a client (Dask, the module ray, an executor)."""

class Table:
    csv: str
    """The text that `nsim sweep -o` writes."""
    @property
    def columns(self) -> list[str]: ...
    @property
    def rows(self) -> list[dict[str, str]]: ...
    def table(self) -> Any:
        """A data frame of pandas, or of polars."""
    def __len__(self) -> int: ...

class Signal:
    """The value of a population of kind Signal, in place of a trace of the target's spikes."""

    def __init__(self, population: str) -> None: ...

class Rule:
    """A learning rule: changes as text, traces as (impulse, tau), y1 to y3 also a `Signal`, r1 as (population, impulse, tau)."""

    def __init__(
        self,
        dw: Optional[str] = None,
        *,
        dd: Optional[str] = None,
        dt: Optional[str] = None,
        epoch: Optional[int] = None,
        x1: Any = None,
        x2: Any = None,
        y1: Any = None,
        y2: Any = None,
        y3: Any = None,
        r1: Any = None,
        tags: Any = None,
        delays: Any = None,
        graded: Optional[str] = None,
        until: Optional[int] = None,
    ) -> None: ...

class Pes:
    """The rule PES: `error` is a population of kind Signal, x1 is (impulse, tau)."""

    def __init__(self, error: str, *, x1: Any, until: Optional[int] = None) -> None: ...

class Network:
    def __init__(
        self,
        name: str,
        populations: Sequence[dict[str, Any]],
        projections: Sequence[dict[str, Any]],
        *,
        output: str,
        timestep_ms: float = 1.0,
        classes: Sequence[str] = (),
        learning_semantics: Optional[str] = None,
    ) -> None:
        """Populations and projections as in a model file; weights are `[target, source]`, a kernel, or a SciPy sparse array;
        learning is a `Rule`, a `Pes` or its text."""
    @property
    def notes(self) -> list[str]:
        """Conventions by which another tool's network was read."""
    @property
    def warnings(self) -> list[dict[str, Any]]:
        """Warnings of the reader and of the conversion to integers: code, population, message."""
    @property
    def name(self) -> str: ...
    @property
    def populations(self) -> list[tuple[str, str, list[int]]]:
        """(name, kind, shape) in the order of the file; kind is 'input', 'integers' or 'real'."""
    @property
    def classes(self) -> list[str]: ...
    def map(
        self,
        target: Path = "nahuku-32",
        *,
        copies: Optional[int] = None,
        deployment: str = "spread",
        strategy: str = "multilevel",
        objective: str = "cores",
        seed: int = 0,
        mapping: Optional[Path] = None,
    ) -> Mapping:
        """This network on the cores of a target, as in `nsim map`; `mapping` is a saved mapping."""
    def energy(
        self,
        spikes: Spikes = None,
        *,
        target: Path = "nahuku-32",
        copies: Optional[int] = None,
        deployment: Path = "spread",
        mode: str = "offline",
        convention: str = "physical",
        constants: Optional[Path] = None,
        transport: str = "queued",
        host: Optional[str] = None,
        streams: str = "one",
        reset_words: int = 0,
        accounting: str = "profiler",
        early_exit: Union[str, int, None] = None,
        baselines: Sequence[str] = (),
        labels: Optional[Sequence[int]] = None,
        samples: Optional[tuple[int, int]] = None,
        repeat: int = 1,
        seed: Optional[int] = None,
        time_first: bool = False,
    ) -> Energy:
        """The report of `nsim energy`, for 1 copy unless `copies` is greater or `deployment` is 'paper'."""

    def agree(
        self,
        spikes: Spikes = None,
        *,
        target: Optional[Path] = None,
        against: Union[str, "PathLike[str]", Network, "Conversion", None] = None,
        conversion: str = "search",
        calibrate: Sources = None,
        calibration_samples: int = 60,
        delayed_copies: Optional[int] = None,
        steps: Optional[int] = None,
        attribution: bool = True,
        attribution_samples: int = 100,
        plot: Optional[Path] = None,
        force: bool = False,
        labels: Optional[Sequence[int]] = None,
        samples: Optional[tuple[int, int]] = None,
        repeat: int = 1,
        seed: Optional[int] = None,
        time_first: bool = False,
    ) -> Agreement:
        """Disagreement of the integers with the trained network, and its causes: `nsim agree`."""

    def convert(
        self,
        spikes: Spikes = None,
        *,
        target: Path = "nahuku-32",
        calibrate: Sources = None,
        calibration_samples: int = 60,
        delayed_copies: Optional[int] = None,
        fine_tune: int = 0,
        training: Optional[Path] = None,
        train: Sources = None,
        labels: Optional[Sequence[int]] = None,
        samples: Optional[tuple[int, int]] = None,
        repeat: int = 1,
        seed: Optional[int] = None,
        time_first: bool = False,
    ) -> Conversion:
        """The network in integers, by a search on samples: `nsim convert`."""
    def report(
        self,
        path: Path,
        spikes: Spikes = None,
        *,
        target: Path = "nahuku-32",
        copies: Optional[int] = None,
        force: bool = False,
        **options: Any,
    ) -> "PathLike[str]":
        """Writes the page of `nsim report`; the other options are as in `energy`."""
    def save(self, path: Path, *, force: bool = False) -> list[str]:
        """Writes a model file, and its arrays next to it."""

class Conversion:
    @property
    def network(self) -> Network:
        """The network in integers."""
    @property
    def class_agreement(self) -> Optional[float]:
        """Share on held-out samples; without any, on the samples of the search."""
    @property
    def stages(self) -> list[dict[str, Any]]: ...
    @property
    def layers(self) -> list[dict[str, Any]]: ...
    def save(self, path: Path, *, force: bool = False) -> list[str]:
        """Writes the files of `nsim convert -o`."""
    def table(self) -> Any:
        """A data frame of pandas, or of polars."""
    def json(self) -> dict[str, Any]:
        """The object that `nsim convert --format json` prints."""
    def _repr_html_(self) -> str: ...

class Training:
    @property
    def network(self) -> Network:
        """The trained network."""
    @property
    def train_accuracy(self) -> float: ...
    @property
    def test_accuracy(self) -> Optional[float]: ...
    @property
    def folds(self) -> list[float]: ...
    @property
    def digest(self) -> str:
        """SHA-256 of the output spikes on the test samples."""
    @property
    def history(self) -> list[tuple[int, float, float]]:
        """(epoch, mean loss, accuracy)."""
    def csv(self) -> str:
        """The history as `nsim train --log` writes it."""
    def save(self, path: Path, *, force: bool = False) -> list["PathLike[str]"]:
        """Writes the files of `nsim train -o`."""
    def table(self) -> Any:
        """A data frame of pandas, or of polars."""
    def json(self) -> dict[str, Any]:
        """The object that `nsim train --format json` prints."""
    def _repr_html_(self) -> str: ...

def train(
    config: Path,
    *,
    train: Union[Sources, tuple[Spikes, Sequence[int]]] = None,
    test: Union[Sources, tuple[Spikes, Sequence[int]]] = None,
    seed: Optional[int] = None,
    epochs: Optional[int] = None,
    set: Optional[dict[str, Any]] = None,
    folds: Optional[int] = None,
    checkpoint: Optional[Path] = None,
    time_first: bool = False,
) -> Training:
    """Trains the network of a training file (its path or its text): `nsim train`."""

class Agreement:
    @property
    def class_agreement(self) -> Optional[float]: ...
    @property
    def layers(self) -> list[dict[str, Any]]: ...
    @property
    def attribution(self) -> list[dict[str, Any]]: ...
    def table(self) -> Any:
        """A data frame of pandas, or of polars."""
    def json(self) -> dict[str, Any]:
        """The object that `nsim agree --format json` prints."""
    def _repr_html_(self) -> str: ...

class Mapping:
    @property
    def model(self) -> str: ...
    @property
    def target(self) -> str: ...
    @property
    def copies(self) -> int: ...
    @property
    def cores(self) -> int: ...
    @property
    def chips(self) -> int: ...
    @property
    def strategy(self) -> str: ...
    @property
    def seed(self) -> int: ...
    @property
    def compartments(self) -> int:
        """Compartments of all copies."""
    @property
    def populations(self) -> list[tuple[str, str, list[int]]]:
        """(name, kind, shape) of one copy as it runs; kind is 'input' or 'integers'."""
    @property
    def output(self) -> str:
        """The output population, which decides the class."""
    def projections(self) -> list[dict[str, Any]]:
        """Integer weights of one copy, `[target, source]` or `[C', C / groups, kh, kw]`, with exponent, delay and window."""
    def to_ron(self) -> str:
        """The text that `nsim map -o` writes."""
    def run(
        self,
        spikes: Spikes = None,
        *,
        labels: Optional[Sequence[int]] = None,
        samples: Optional[tuple[int, int]] = None,
        repeat: int = 1,
        seed: Optional[int] = None,
        time_first: bool = False,
        early_exit: Union[str, int, None] = None,
        probe: Sequence[str] = (),
        draws: Optional[Dictionary[str, Path]] = None,
        fresh: bool = False,
    ) -> Run:
        """Runs `[channels.., T]`, `[samples, channels.., T]`, a dictionary of such arrays, sources, or the model's scene."""
    def session(self, seed: Optional[int] = None, *, energy: Union[bool, dict[str, Any], None] = None) -> Session:
        """Opens a session, which a loop steps. Its timesteps are metered, unless `energy` is False; it may be the options of `energy`."""
    def energy(
        self,
        spikes: Spikes = None,
        *,
        deployment: Optional[Path] = None,
        mode: str = "offline",
        convention: str = "physical",
        constants: Optional[Path] = None,
        transport: str = "queued",
        host: Optional[str] = None,
        streams: str = "one",
        reset_words: int = 0,
        accounting: str = "profiler",
        early_exit: Union[str, int, None] = None,
        baselines: Sequence[str] = (),
        labels: Optional[Sequence[int]] = None,
        samples: Optional[tuple[int, int]] = None,
        repeat: int = 1,
        seed: Optional[int] = None,
        time_first: bool = False,
    ) -> Energy:
        """Runs the samples and prices them."""
    def bench(
        self,
        spikes: Spikes = None,
        *,
        seconds: float = 1.0,
        skip: bool = True,
        labels: Optional[Sequence[int]] = None,
        samples: Optional[tuple[int, int]] = None,
        repeat: int = 1,
        seed: Optional[int] = None,
        time_first: bool = False,
    ) -> dict[str, Any]:
        """Time to simulate a timestep on one thread."""
    def report(self, path: Path, spikes: Spikes = None, *, force: bool = False, **options: Any) -> "PathLike[str]":
        """Writes the page of `nsim report`; the other options are as in `energy`."""

class Session:
    """A mapping after some timestep."""

    def step(self, inputs: Union[dict[str, Channels], Channels, None] = None) -> None:
        """Runs one timestep with the channels of each input population that spike: their numbers, or a truth value each;
        an input population that sends integers takes an integer for each channel."""
    def run(
        self, inputs: Any = None, steps: Optional[int] = None, probes: Optional[Sequence[str]] = None
    ) -> dict[str, NDArray[np.int32]]:
        """Runs several timesteps; `inputs` are arrays `[channels.., steps]` or Events, by input population. Probes, such as
        "out.v" or "out.spikes", give arrays `[steps, units]`."""
    @property
    def steps(self) -> int:
        """Timesteps since the session was opened or reset."""
    def __getitem__(self, population: str) -> Population: ...
    @property
    def weights(self) -> Values:
        """Weights with which the next timestep delivers, by projection that learns, one a synapse; they can be set."""
    @property
    def delays(self) -> Values:
        """Delays, as `weights`; read-only."""
    @property
    def tags(self) -> Values:
        """Tags, as `weights`; read-only."""
    @property
    def traces(self) -> Values:
        """Traces by NAME.x1 and so on; read-only."""
    @property
    def signal(self) -> Values:
        """Values of signals in the next timestep, by population; 0 unless set."""
    @property
    def draws(self) -> Values:
        """Random numbers of the next timestep, by projection; as read, how many it takes."""
    @property
    def added(self) -> Values:
        """Integers that the next timestep adds to each compartment: POPULATION.q to arrivals, POPULATION.bias to u + bias."""
    @property
    def overflow(self) -> dict[str, int]:
        """Registers that left their width since the session was opened or reset: q, u (or u + bias), v."""
    def snapshot(self) -> Snapshot: ...
    def restore(self, snapshot: Snapshot) -> None: ...
    def reset(self, learned: bool = True) -> None:
        """Returns to before the first timestep; with learned=False also to the weights of the model."""
    def energy(self) -> Energy:
        """Cost of the timesteps so far, unless the session was opened with `energy=False`."""
    def __enter__(self) -> Session: ...
    def __exit__(self, *exception: object) -> None: ...

class Values:
    """Values of a session by name."""

    def __getitem__(self, name: str) -> Any: ...
    def __setitem__(self, name: str, values: Any) -> None: ...
    def keys(self) -> list[str]: ...

class Snapshot:
    """The state of a session after some timestep."""

class Population:
    """Spikes and state of a population of a session after the last timestep."""

    @property
    def spikes(self) -> NDArray[np.int32]:
        """Numbers of the units that spiked, ascending."""
    @property
    def values(self) -> NDArray[np.int32]:
        """Integer of each of these spikes, 1 for a binary spike."""
    @property
    def v(self) -> NDArray[np.int32]: ...
    @property
    def u(self) -> NDArray[np.int32]: ...
    def state(self, name: str) -> NDArray[np.int32]:
        """A word of state of each neuron by the name of the word, such as sigma."""
    def __len__(self) -> int: ...

class Run:
    @property
    def digest(self) -> str:
        """SHA-256 of the output spikes."""
    @property
    def counts(self) -> NDArray[np.uint32]:
        """Spikes of each output, `[samples, outputs]`; all 0 where a potential decides."""
    @property
    def scores(self) -> NDArray[np.float64]:
        """Scores of the decision, `[samples, outputs]`: spikes, or numbers of the potential."""
    @property
    def predicted(self) -> list[Optional[int]]: ...
    @property
    def labels(self) -> list[Optional[int]]: ...
    @property
    def accuracy(self) -> Optional[float]: ...
    @property
    def steps(self) -> list[int]: ...
    @property
    def spikes(self) -> NDArray[np.uint32]:
        """(sample, step, output) of each output spike, `[spikes, 3]`."""
    @property
    def activity(self) -> dict[str, Any]: ...
    @property
    def warnings(self) -> list[dict[str, Any]]:
        """Warnings: code, population, message."""
    def probe(self, name: str) -> NDArray[np.int32]:
        """The recording of `run(probe=[name])`, `[samples, compartments, T]`."""
    def learned(self, path: Path, *, freeze: bool = False, force: bool = False) -> list[str]:
        """Writes the model with what its rules have learned."""
    def samples(self) -> Any:
        """A data frame with a row for each sample: sample, label, predicted, steps, counts_0 and so on."""
    def neurobench(self) -> dict[str, Any]:
        """The metrics of NeuroBench's harness, a sample."""
    @property
    def wall_s(self) -> float: ...
    def table(self) -> Any:
        """A data frame of pandas, or of polars."""
    def json(self) -> dict[str, Any]:
        """The object that `nsim run --format json` prints."""
    def _repr_html_(self) -> str: ...
    def __len__(self) -> int: ...

class Energy:
    @property
    def energy_uj(self) -> Optional[float]:
        """Energy of a timestep of one copy, in uJ."""
    @property
    def latency_us(self) -> Optional[float]:
        """Time of a timestep, in us."""
    @property
    def rows(self) -> list[dict[str, Any]]: ...
    @property
    def warnings(self) -> list[dict[str, Any]]:
        """Warnings, as of a run."""
    def table(self) -> Any:
        """A data frame of pandas, or of polars."""
    def json(self) -> dict[str, Any]:
        """The object that `nsim energy --format json` prints."""
    def _repr_html_(self) -> str: ...
