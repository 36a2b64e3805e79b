"""The type stubs have the names, parameters and defaults of the module."""

import ast
import inspect
import unittest
from pathlib import Path

import nsim

STUBS = ast.parse((Path(nsim.__file__).parent / "__init__.pyi").read_text())
SKIPPED = {"self", "slf"}


def of_stub(function):
    """{name: default as text or None} of a function of the stubs, and whether it takes any keyword."""
    arguments = function.args
    positional = arguments.posonlyargs + arguments.args
    defaults = [None] * (len(positional) - len(arguments.defaults)) + arguments.defaults
    pairs = [*zip(positional, defaults), *zip(arguments.kwonlyargs, arguments.kw_defaults)]
    named = {argument.arg: default and ast.unparse(default) for argument, default in pairs}
    return {name: default for name, default in named.items() if name not in SKIPPED}, arguments.kwarg is not None


def of_module(function):
    """The same of a function of the module."""
    parameters = inspect.signature(function).parameters.values()
    takes_any = any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters)
    named = [parameter for parameter in parameters if parameter.kind is not parameter.VAR_KEYWORD]
    default = lambda parameter: None if parameter.default is parameter.empty else repr(parameter.default)
    return {parameter.name: default(parameter) for parameter in named if parameter.name not in SKIPPED}, takes_any


class Stubs(unittest.TestCase):
    def compare(self, stub, real, takes_any):
        self.assertEqual(sorted(set(real) - set(stub)), [], "parameters that the stubs lack")
        if not takes_any:
            self.assertEqual(sorted(set(stub) - set(real)), [], "parameters that the module lacks")
        for name in set(stub) & set(real):
            self.assertEqual(stub[name] and stub[name].replace('"', "'"), real[name], name)

    def test_functions_have_the_parameters_of_the_stubs(self):
        compared = 0
        found = [(None, node) for node in STUBS.body]
        found += [(node.name, inner) for node in STUBS.body if isinstance(node, ast.ClassDef) for inner in node.body]
        for owner, node in found:
            if not isinstance(node, (ast.FunctionDef, ast.ClassDef)) or node.name.startswith("__"):
                continue
            module = getattr(nsim, owner) if owner else nsim
            self.assertTrue(hasattr(module, node.name), f"{owner}.{node.name} is not in the module")
            properties = [d for d in getattr(node, "decorator_list", []) if ast.unparse(d).endswith(("property", "setter"))]
            if isinstance(node, ast.ClassDef) or properties:
                continue
            (stub, _), (real, takes_any) = of_stub(node), of_module(getattr(module, node.name))
            with self.subTest(f"{owner}.{node.name}"):
                self.compare(stub, real, takes_any)
            compared += 1
        self.assertGreater(compared, 30)

    def test_public_names_are_in_the_stubs(self):
        stubs = {getattr(node, "name", None) for node in STUBS.body}
        public = {name for name in getattr(nsim, "__all__", dir(nsim)) if not name.startswith("_")}
        public = {name for name in public if not inspect.ismodule(getattr(nsim, name))}
        self.assertEqual(sorted(public - stubs), [])


if __name__ == "__main__":
    unittest.main()
