"""Every notebook runs from its first cell to its last; a notebook that needs an absent package is reported as skipped."""

import json
import os
import re
import sys
import tempfile
import unittest

FOLDER = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "notebooks")


def cells(path):
    with open(path) as file:
        book = json.load(file)
    return [cell for cell in book["cells"] if cell["cell_type"] == "code"], book["cells"][0]


class Notebooks(unittest.TestCase):
    def test_they_run(self):
        names = sorted(name for name in os.listdir(FOLDER) if name.endswith(".ipynb"))
        self.assertEqual(len(names), 4)
        before = os.getcwd()
        for name in names:
            code, head = cells(os.path.join(FOLDER, name))
            needs = re.search(r"Needs `pip install ([a-z ]+)`", "".join(head["source"])).group(1).split()
            absent = [package for package in needs if not importable(package)]
            if absent:
                print(f"absent: {', '.join(absent)}, {name} was not run", file=sys.stderr)
                continue
            with self.subTest(notebook=name), tempfile.TemporaryDirectory() as folder:
                os.chdir(folder)
                try:
                    names_of = {}
                    for cell in code:
                        # The last expression of a cell is shown; here it only has to have a value.
                        exec(compile("".join(cell["source"]), name, "exec"), names_of)
                finally:
                    os.chdir(before)

    def test_none_holds_outputs(self):
        for name in os.listdir(FOLDER):
            for cell in cells(os.path.join(FOLDER, name))[0]:
                self.assertEqual((cell["outputs"], cell["execution_count"]), ([], None), name)


def importable(package):
    try:
        __import__(package)
    except ImportError:
        return False
    return True


if __name__ == "__main__":
    unittest.main()
