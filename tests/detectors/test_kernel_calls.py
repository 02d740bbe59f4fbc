"""Calls of Triton's kernels, which no CPU makes: each names a function of its module, and arguments that it takes."""

import ast
import inspect
from pathlib import Path
from typing import NamedTuple

import pytest

torch = pytest.importorskip("torch")

from small import small_detector

from farfield import detectors
from farfield.detectors.anchors import head
from farfield.detectors.anchors.head import AnchorGrid

ROOM = Path(detectors.__file__).parent


class KernelCall(NamedTuple):
    """A call of a function of a module of kernels.

    Args:
        module: Name of the module below ``farfield.detectors``, such as ``"triton_nms"``.
        function: What is called.
        call: The call; None where the function is handed on, as in ``partial(kernels.find_rows, ...)``.
        where: File and line.
    """

    module: str
    function: str
    call: ast.Call | None
    where: str


def kernel_calls() -> list[KernelCall]:
    """All uses of a variable ``kernels`` in the room; a function that is handed it has the module of its file."""
    calls = []
    for path in sorted(ROOM.rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        modules = _modules_in(tree)
        for function in (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)):
            own = _modules_in(function) or modules
            calls += [] if not own else _uses_in(function, own[0], path)
    return calls


def _modules_in(tree: ast.AST) -> list[str]:
    """Modules of kernels that are asked for."""
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
    modules = [call.args[1].value for call in calls if _called(call) == "kernels_for" and len(call.args) == 2]
    modules += ["sparse.triton_kernels" for call in calls if _called(call) == "_gpu_kernels"]
    return [str(module) for module in modules]


def _uses_in(function: ast.FunctionDef, module: str, path: Path) -> list[KernelCall]:
    nodes = list(ast.walk(function))
    by_function = {id(node.func): node for node in nodes if isinstance(node, ast.Call)}
    return [
        KernelCall(module, node.attr, by_function.get(id(node)), f"{path.relative_to(ROOM)}:{node.lineno}")
        for node in nodes
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "kernels"
    ]


def _called(call: ast.Call) -> str:
    return call.func.id if isinstance(call.func, ast.Name) else ""


def functions_of(module: str) -> dict[str, ast.FunctionDef]:
    """The functions of a module of kernels by name, read without importing Triton."""
    path = ROOM.joinpath(*module.split(".")).with_suffix(".py")
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return {node.name: node for node in tree.body if isinstance(node, ast.FunctionDef)}


def parameters_of(function: ast.FunctionDef) -> list[str]:
    """Names of the arguments that a function takes."""
    arguments = function.args
    return [argument.arg for argument in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs)]


def test_calls_are_found() -> None:
    modules = {
        path.relative_to(ROOM).with_suffix("").as_posix().replace("/", ".") for path in ROOM.rglob("triton_*.py")
    }
    assert {call.module for call in kernel_calls()} == modules


@pytest.mark.parametrize("call", kernel_calls(), ids=lambda call: f"{call.where} {call.function}")
def test_a_kernel_is_there_and_takes_what_it_is_called_with(call: KernelCall) -> None:
    functions = functions_of(call.module)
    assert call.function in functions
    names = parameters_of(functions[call.function])
    if call.call is not None:
        assert {keyword.arg for keyword in call.call.keywords if keyword.arg is not None} <= set(names)
        assert sum(not isinstance(argument, ast.Starred) for argument in call.call.args) <= len(names)


def test_the_numbers_of_anchors_are_those_that_decoding_takes() -> None:
    network = small_detector("pointpillars")
    grid = next(value for value in vars(network.head).values() if isinstance(value, AnchorGrid))
    decoded = functions_of("anchors.triton_decode")["decoded"]
    keywords = [argument.arg for argument in decoded.args.kwonlyargs]
    assert sorted(head.constants(grid, torch.device("cpu"))) == sorted(keywords)
    assert list(inspect.signature(head.decoded).parameters)[1:] == [argument.arg for argument in decoded.args.args]
