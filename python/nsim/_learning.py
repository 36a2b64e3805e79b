"""Learning rules of projections, as text of a model file."""

import json
from typing import Any, Optional


def _number(value: Any) -> str:
    """A number, or numbers in rows, as a model file has them."""
    rows = value.tolist() if hasattr(value, "tolist") else value
    return f"[{', '.join(map(_number, rows))}]" if isinstance(rows, (list, tuple)) else repr(rows)


def _trace(value: Any) -> str:
    """A trace (impulse, tau), or a signal."""
    if isinstance(value, Signal):
        return f"Signal({json.dumps(value.population, ensure_ascii=False)})"
    impulse, tau = value
    return f"(impulse: {_number(impulse)}, tau: {_number(tau)})"


def _stated(kind: str, fields: dict[str, Optional[str]]) -> str:
    return f"{kind}({', '.join(f'{name}: {text}' for name, text in fields.items() if text is not None)})"


class Signal:
    """The value of a population of kind Signal, in place of a trace of the target's spikes."""

    def __init__(self, population: str) -> None:
        self.population = population


class Rule:
    """A learning rule: the changes of weights, delays and tags, as text. A trace is (impulse, tau), y1 to y3 also a `Signal`,
    r1 a population with them: (population, impulse, tau). The other arguments are the fields of a model file."""

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
    ) -> None:
        fields = {name: text and json.dumps(text, ensure_ascii=False) for name, text in {"dw": dw, "dd": dd, "dt": dt}.items()}
        fields["epoch"] = None if epoch is None else _number(epoch)
        traces = {"x1": x1, "x2": x2, "y1": y1, "y2": y2, "y3": y3}
        fields |= {name: None if trace is None else _trace(trace) for name, trace in traces.items()}
        if r1 is not None:
            population, impulse, tau = r1
            fields["r1"] = f"(from: {json.dumps(population, ensure_ascii=False)}, {_trace((impulse, tau))[1:]}"
        numbers = {"tags": tags, "delays": delays, "until": until}
        fields |= {name: None if value is None else _number(value) for name, value in numbers.items()}
        self._text = _stated("Rule", {**fields, "graded": graded})

    def __str__(self) -> str:
        return self._text


class Pes:
    """The rule PES of nengo-loihi: `error` is a population of kind Signal, x1 is (impulse, tau)."""

    def __init__(self, error: str, *, x1: Any, until: Optional[int] = None) -> None:
        fields = {"error": json.dumps(error, ensure_ascii=False), "x1": _trace(x1)}
        self._text = _stated("Pes", {**fields, "until": None if until is None else _number(until)})

    def __str__(self) -> str:
        return self._text
