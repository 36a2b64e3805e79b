"""Every notebook runs from its first cell to its last; a notebook that needs an absent package is reported as skipped.

Those in `SHOWN` hold their outputs, which running gives; NSIM_BLESS=1 stores them anew. The others hold none.
"""

import ast
import base64
import contextlib
import io
import json
import os
import re
import sys
import tempfile
import unittest

FOLDER = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "notebooks")
SHOWN = {"5-nengo.ipynb"}


def read(name):
    with open(os.path.join(FOLDER, name)) as file:
        return json.load(file)


def code_cells(book):
    return [cell for cell in book["cells"] if cell["cell_type"] == "code"]


def notebooks():
    return sorted(name for name in os.listdir(FOLDER) if name.endswith(".ipynb"))


def outputs(source, name, names):
    """Runs a cell with `names`: what Jupyter shows of its prints, its last expression and its figures."""
    tree, value, printed = ast.parse(source, name), None, io.StringIO()
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    with contextlib.redirect_stdout(printed):
        exec(compile(tree, name, "exec"), names)
        if last is not None:
            value = eval(compile(ast.Expression(last.value), name, "eval"), names)
    shown = [{"name": "stdout", "output_type": "stream", "text": lines(printed.getvalue())}] if printed.getvalue() else []
    if value is not None and not source.rstrip().endswith(";"):
        data = {"text/plain": lines(repr(value))}
        shown.append({"data": data, "execution_count": None, "metadata": {}, "output_type": "execute_result"})
    return shown + figures()


def figures():
    """The open figures as outputs; they are closed."""
    plt, shown = sys.modules.get("matplotlib.pyplot"), []
    for number in plt.get_fignums() if plt else ():
        figure, png = plt.figure(number), io.BytesIO()
        figure.savefig(png, format="png", dpi=72)
        data = {"image/png": base64.b64encode(png.getvalue()).decode(), "text/plain": [repr(figure)]}
        shown.append({"data": data, "metadata": {}, "output_type": "display_data"})
        plt.close(figure)
    return shown


def lines(text):
    return text.splitlines(keepends=True)


def texts(shown):
    """The text of outputs, without pictures."""
    return ["".join(output.get("text") or output["data"]["text/plain"]) for output in shown]


class Notebooks(unittest.TestCase):
    def test_they_run(self):
        self.assertEqual(len(notebooks()), 5)
        before = os.getcwd()
        for name in notebooks():
            book = read(name)
            needs = re.search(r"Needs `pip install ([a-z -]+)`", "".join(book["cells"][0]["source"])).group(1).split()
            absent = [package for package in needs if not importable(package.replace("-", "_"))]
            if absent:
                print(f"absent: {', '.join(absent)}, {name} was not run", file=sys.stderr)
                continue
            with self.subTest(notebook=name), tempfile.TemporaryDirectory() as folder:
                os.chdir(folder)
                try:
                    names = {}
                    shown = [outputs("".join(cell["source"]), name, names) for cell in code_cells(book)]
                finally:
                    os.chdir(before)
                if name in SHOWN and os.environ.get("NSIM_BLESS"):
                    store(name, book, shown)
                elif name in SHOWN:
                    for cell, own in zip(code_cells(book), shown):
                        self.assertEqual(texts(cell["outputs"]), texts(own))

    def test_they_store_the_outputs_that_are_shown(self):
        for name in notebooks():
            stored = [output for cell in code_cells(read(name)) for output in cell["outputs"]]
            self.assertEqual(bool(stored), name in SHOWN, name)
            pictures = [output["data"]["image/png"] for output in stored if "image/png" in output.get("data", {})]
            self.assertLess(sum(len(base64.b64decode(picture)) for picture in pictures), 30_000, name)
            self.assertTrue(all(cell["execution_count"] is None for cell in code_cells(read(name))), name)


def store(name, book, shown):
    """Writes the outputs of each code cell into a notebook."""
    for cell, own in zip(code_cells(book), shown):
        cell["outputs"] = own
    with open(os.path.join(FOLDER, name), "w") as file:
        file.write(json.dumps(book, indent=1, ensure_ascii=False) + "\n")


def importable(package):
    try:
        __import__(package)
    except ImportError:
        return False
    return True


if __name__ == "__main__":
    unittest.main()
