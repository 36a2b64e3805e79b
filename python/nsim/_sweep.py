"""Sweeps: many variants of a run, in this process or on the workers of a client."""

import csv
import io
import os

from . import _nsim


def _part(path, text, number, parts):
    """Runs a part on one thread, in the calling process."""
    return _nsim.sweep_part(path, text, number, parts, 1)


class Table:
    """The table of a sweep: a row for each variant, sorted."""

    def __init__(self, text):
        self.csv = text
        """The text that `nsim sweep -o` writes."""

    @property
    def columns(self):
        """Names of the columns."""
        return next(csv.reader(io.StringIO(self.csv)))

    @property
    def rows(self):
        """A dictionary for each variant; cells are text as in the file, empty where a figure is unknown."""
        return list(csv.DictReader(io.StringIO(self.csv)))

    def table(self):
        """The table as a data frame of pandas, or of polars where only that is installed."""
        file = io.BytesIO(self.csv.encode())
        try:
            import pandas
        except ImportError:
            try:
                import polars
            except ImportError:
                raise ImportError("tables are data frames of pandas: pip install pandas") from None
            return polars.read_csv(file, infer_schema_length=None)
        return pandas.read_csv(file)

    def _repr_html_(self):
        return self.table()._repr_html_()

    def __len__(self):
        return len(self.rows)

    def __repr__(self):
        return f"<nsim.Table of {len(self)} variants: {', '.join(self.columns)}>"


def _on_client(client, path, text, parts):
    arguments = [(path, text, number, parts) for number in range(parts)]
    if hasattr(client, "gather"):
        # Dask: every call runs its parts again, as their files may have changed.
        return client.gather([client.submit(_part, *part, pure=False) for part in arguments])
    if hasattr(client, "remote") and hasattr(client, "get"):
        part = client.remote(_part)
        return client.get([part.remote(*argument) for argument in arguments])
    if hasattr(client, "submit"):
        return [future.result() for future in [client.submit(_part, *part) for part in arguments]]
    raise TypeError("client must be a Dask client, the module ray, or an executor of concurrent.futures")


def sweep(sweep, *, threads=None, client=None, parts=None):
    """Runs every variant of a sweep: `nsim sweep`.

    `sweep` is the path of a sweep file, or its text, which begins with `Sweep(`. Without `client` it runs on `threads` threads of this
    process (all cores). A `client` is a Dask client, the module `ray`, or an executor; it runs `parts` parts (64, or the number of
    variants if fewer), each on one thread. The workers read the files that the sweep names under the same paths.
    """
    text, path = os.fspath(sweep), "sweep"
    if not text.lstrip().startswith("Sweep("):
        path = text
        with open(path, encoding="utf-8") as file:
            text = file.read()
    if client is None:
        threads = threads or os.cpu_count() or 1
        return Table(_nsim.sweep_part(path, text, 0, 1, threads))
    variants = _nsim.sweep_len(path, text)
    parts = max(1, min(parts or 64, variants))
    return Table(_nsim.sweep_merged(path, text, _on_client(client, path, text, parts)))
