"""Integer literals that index a record of constants, found by tracing arrays through the syntax trees.

``python -m tests.support.record_fields`` prints them and fails if there are any; ``make lint`` runs it.

An array is a *record*, whatever its name is, if it

- is the first argument of a kernel, a residual or a ``fill`` of an :class:`factors._contract.Equation`,
- is indexed by a field of a :class:`factors.records.Record` anywhere in the function, or created in its size,
- is packed by one, or is an attribute ``record``, ``records`` or ``control_records``,
- is made of records by slices, arithmetic, ``copy`` and the like, is passed on to a function, comes back from one, or
  is handed to a function that takes a record.

No integer may index a record: neither ``c[3]``, ``c[3:6]``, ``c[:, 18]`` nor ``c[i + 22 * n]``, nor an offset that is
passed to a function which indexes with it. In ``factors/`` and ``fg_orient/kernels/`` an integer above 0 may index an
array only if the array is
*free*, that is provably something else: a tuple, a shape, numbers that the function itself put into a small array, a
vector of three numbers (a field of a record, a parameter annotated ``Vector``), an integer array (``Index``), the
setup or the unknowns of an equation. A neighbour, ``a[k + 1]``, is free as well. Where nothing is known of an array
with two axes, columns 0 to 2 may be numbered: matrices of coordinates.
"""

from __future__ import annotations

import ast
import functools
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).parents[2]
#: Folders, and whether arrays of which nothing is known count there.
FOLDERS = {"factors": True, "fg_orient/kernels": True, "fg_orient": False, "examples": False, "benchmarks": False}

RECORD, FREE, UNKNOWN, NOTHING = "record", "free", "unknown", "nothing yet"
Kind = str | tuple["Kind", ...]
#: Annotations of integer arrays and of tuples, and the largest index that they allow.
FREE_TYPES = {"Index": 10**9, "Small": 10**9, "Flags": 10**9, "Vector": 2, "Matrix": 8, "Block": 5, "Gradient": 2}
RECORD_ATTRIBUTES = {"record", "records", "control_records"}
FREE_ATTRIBUTES = {"shape", "size", "start", "stop", "setup", "unknowns", "dtype"}
#: Functions that give tuples, lists or numbers.
FREE_CALLS = {
    "cross",
    "unique",
    "meshgrid",
    "len",
    "int",
    "float",
    "list",
    "kernel",
    "partition",
    "sorted",
    "range",
    "split",
}
#: Functions and methods that return their argument in another form.
SAME = {"copy", "ravel", "astype", "ascontiguousarray", "asarray", "array", "concatenate", "append", "hstack", "tile",
        "where", "reshape", "abs", "sum", "sqrt", "real", "imag", "T", "take"}  # fmt: skip


def join(*kinds: Kind) -> Kind:
    """Return the kind of what may be any of these, or is computed from all of them."""
    flat = {k if isinstance(k, str) else join(*k) for k in kinds}
    return next((k for k in (RECORD, UNKNOWN, FREE) if k in flat), NOTHING if flat else FREE)


def merge(a: Kind, b: Kind) -> Kind:
    """Return the kind of what may be either of these; tuples of one length stay tuples."""
    if isinstance(a, tuple) and isinstance(b, tuple) and len(a) == len(b):
        return tuple(merge(x, y) for x, y in zip(a, b, strict=True))
    if FREE in (a, b) and not (isinstance(a, str) and isinstance(b, str)):
        return RECORD if join(a, b) == RECORD else FREE
    return a if a == b or b == NOTHING else b if a == NOTHING else join(a, b)


@dataclass(eq=False)
class Function:
    """A function with what is known of its parameters, variables and result."""

    module: Module
    node: ast.FunctionDef
    passed: dict[str, Kind] = field(default_factory=dict)
    fixed: dict[str, Kind] = field(default_factory=dict)
    known: dict[str, Kind] = field(default_factory=dict)
    result: Kind = NOTHING
    is_traced: bool = False
    indexed: set[tuple[str, str]] = field(default_factory=set)
    limits: dict[str, int] = field(default_factory=dict)

    @property
    def parameters(self) -> list[str]:
        """Return the names of the positional parameters."""
        return [a.arg for a in self.node.args.args]

    def state(self) -> tuple[object, ...]:
        """Return all that is known: the tracing ends when it no longer changes."""
        return dict(self.passed), dict(self.fixed), dict(self.known), self.result, len(self.indexed)

    def kind(self, name: str) -> Kind:
        """Return the kind of a variable; of a parameter that of its arguments."""
        if self.fixed.get(name) == RECORD or RECORD in (self.known.get(name), self.passed.get(name)):
            return RECORD
        if name in self.fixed:
            return self.fixed[name]
        found = [k for k in (self.known.get(name), self.passed.get(name)) if k is not None]
        if not found and isinstance(self.module.constants.get(name), ast.Tuple):
            return (FREE,) * len(self.module.constants[name].elts)  # type: ignore[attr-defined]
        if not found and not self.is_traced and name in self.parameters:
            return NOTHING
        return functools.reduce(merge, found) if found else UNKNOWN


@dataclass(eq=False)
class Module:
    """A parsed module: its functions, what its names are imported from, and its own variables."""

    path: str
    tree: ast.Module
    functions: dict[str, Function] = field(default_factory=dict)
    imported: dict[str, tuple[str, str]] = field(default_factory=dict)
    constants: dict[str, ast.expr] = field(default_factory=dict)


class Program:
    """All modules together.

    Parameters
    ----------
    sources : dict
        Path relative to the root, and text.
    """

    def __init__(self, sources: dict[str, str]) -> None:
        self.modules = {path.removesuffix(".py").replace("/", "."): Module(path, ast.parse(text))
                        for path, text in sources.items()}  # fmt: skip
        self.sizes: dict[tuple[str, str], int] = {}
        self.names: set[str] = set()
        for module in self.modules.values():
            self._read(module)
        functions = dict.fromkeys(f for m in self.modules.values() for f in m.functions.values())
        self._take_contract()
        self.walks = [_Walk(self, function) for function in functions]
        self._trace()
        for walk in self.walks:  # a function without a kind is not called
            walk.function.is_traced = True
        self._trace()

    def _trace(self) -> None:
        """Follow all arrays until no kind changes."""
        before = None
        while before != (now := [w.function.state() for w in self.walks]):
            before = now
            for walk in self.walks:
                walk.run()

    def _read(self, module: Module) -> None:
        """Read functions, imports and records of a module."""
        for node in ast.walk(module.tree):
            if isinstance(node, ast.FunctionDef):
                function = module.functions[f"{node.name}:{node.lineno}"] = Function(module, node)
                if node in module.tree.body:
                    module.functions[node.name] = function
                for a in (*node.args.args, *node.args.kwonlyargs):
                    text = ast.unparse(a.annotation) if a.annotation else ""
                    if text in FREE_TYPES or text.startswith(("tuple[", "list[")) or a.arg == "setup":
                        function.fixed[a.arg] = FREE
                        function.limits[a.arg] = FREE_TYPES.get(text, 1 if a.arg == "setup" else 10**9)
                if set(function.parameters) >= {"context", "builder"} or function.parameters[:1] == ["_this"]:
                    function.fixed |= dict.fromkeys(function.parameters, FREE)  # called by numba, GTSAM with lists
            elif isinstance(node, ast.ImportFrom) and node.module:
                module.imported |= {a.asname or a.name: (node.module, a.name) for a in node.names}
            if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and node.value:
                module.constants[node.target.id] = node.value
            if isinstance(node, ast.Assign | ast.AnnAssign) and _is_call(node.value, "Record"):
                target = node.targets[0] if isinstance(node, ast.Assign) else node.target
                self.names.add(ast.unparse(target))
                self._read_fields(ast.unparse(target), node.value)  # type: ignore[arg-type]

    def _read_fields(self, record: str, call: ast.Call) -> None:
        """Read the sizes of the fields of a record, and of the numbers that they name."""
        for keyword in call.keywords:
            value = keyword.value.value if isinstance(keyword.value, ast.Constant) else None
            size = len(value.split()) if isinstance(value, str) else value if isinstance(value, int) else 99
            for name in (keyword.arg or "", *(value.split() if isinstance(value, str) else ())):
                own = size if name == keyword.arg else 1
                self.sizes[record, name] = max(self.sizes.get((record, name), 0), own)

    def _take_contract(self) -> None:
        """Set the arguments of kernels, residuals and fills of equations.

        The first one is a record, the others are none.
        """
        for module in self.modules.values():
            made = ("Equation", "register_condition")
            for call in (n for n in ast.walk(module.tree) if any(_is_call(n, name) for name in made)):
                for name in (n for a in call.args for n in ast.walk(a) if isinstance(n, ast.Name)):  # type: ignore[attr-defined]
                    function = self.resolve(module, name)
                    if (function and function.parameters[:1] in (["record"], ["records"])) or (
                        function and name in call.args and len(function.parameters) > 2  # type: ignore[attr-defined]
                    ):
                        first, *others = function.parameters
                        function.fixed |= {first: RECORD, **dict.fromkeys(others, FREE)}

    def resolve(self, module: Module, name: ast.expr) -> Function | None:
        """Return the function to which a name or an attribute of a module refers."""
        if isinstance(name, ast.Name):
            if name.id in module.functions:
                return module.functions[name.id]
            home, attribute = module.imported.get(name.id, ("", ""))
            return self.modules[home].functions.get(attribute) if home in self.modules else None
        if isinstance(name, ast.Attribute) and isinstance(name.value, ast.Name):
            home = ".".join(module.imported.get(name.value.id, ("", "")))
            return self.modules[home].functions.get(name.attr) if home in self.modules else None
        return None

    def is_field(self, node: ast.AST) -> bool:
        """Return whether an expression names a field of a record."""
        if isinstance(node, ast.Attribute) and node.attr in ("start", "stop"):
            return self.is_field(node.value)
        return isinstance(node, ast.Attribute) and node.attr != "size" and _dotted(node.value)[-1] in self.names

    def has_field(self, node: ast.AST) -> bool:
        """Return whether an index is built with a field of a record."""
        return any(self.is_field(part) for part in _own(node))

    def findings(self, strict: dict[str, bool]) -> Iterator[str]:
        """Yield the place and text of each integer that indexes a record."""
        for walk in self.walks:
            path = walk.function.module.path
            counted = next(strict[folder] for folder in strict if path.startswith(f"{folder}/"))
            for line, text in walk.numbered(counted):
                yield f"{path}:{line}: {text}"


def _dotted(node: ast.AST | None) -> list[str]:
    """Return the parts of a dotted name."""
    parts: list[str] = []
    while isinstance(node, ast.Attribute):
        parts.insert(0, node.attr)
        node = node.value
    return [node.id if isinstance(node, ast.Name) else "", *parts]


def _is_call(node: ast.AST | None, name: str) -> bool:
    return isinstance(node, ast.Call) and _dotted(node.func)[-1] == name


def _own(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the parts of an index, without those inside calls and other indices."""
    yield node
    if not isinstance(node, ast.Call | ast.Subscript | ast.Attribute):
        for child in ast.iter_child_nodes(node):
            yield from _own(child)


def _last(index: ast.expr) -> ast.expr:
    """Return the index of the last axis."""
    return index.elts[-1] if isinstance(index, ast.Tuple) and index.elts else index


def _integers(node: ast.AST) -> list[int]:
    return [n.value for n in _own(node) if isinstance(n, ast.Constant) and type(n.value) is int]


def _is_neighbour(node: ast.expr) -> bool:
    """Return whether a node is ``k + 1`` or ``k - 1``, the last element, or all but the first or the last."""
    if isinstance(node, ast.Slice):
        return (isinstance(node.lower, ast.Constant) and node.lower.value == 1 and node.upper is None) or (
            node.lower is None and node.upper is not None and ast.unparse(node.upper) == "-1")  # fmt: skip
    if ast.unparse(node) == "-1":
        return True
    return isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Sub) and (
        isinstance(node.right, ast.Constant) and node.right.value == 1 and not isinstance(node.left, ast.Constant)
    )  # fmt: skip


class _Walk:
    """Kinds of the expressions of one function."""

    def __init__(self, program: Program, function: Function) -> None:
        self.program, self.function = program, function
        inner = {n for f in ast.walk(function.node) if isinstance(f, ast.FunctionDef) and f is not function.node
                 for n in ast.walk(f) if n is not f}  # fmt: skip
        kinds = (ast.Assign, ast.AnnAssign, ast.For, ast.comprehension, ast.Return, ast.Call, ast.Subscript)
        self.nodes = [n for n in ast.walk(function.node) if n not in inner and isinstance(n, kinds)]

    def run(self) -> None:
        """Analyse what the function assigns, passes on and returns."""
        f, results = self.function, []
        for node in self.nodes:
            match node:
                case ast.Assign(targets=targets, value=value):
                    for target in targets:
                        self._assign(target, self.kind(value))
                case ast.AnnAssign(target=target, value=ast.expr() as value):
                    self._assign(target, self.kind(value))
                case ast.For(target=target, iter=over) | ast.comprehension(target=target, iter=over):
                    self._assign(target, self._element(over))
                case ast.Return(value=ast.expr() as value):
                    results.append(self.kind(value))
                case ast.Call():
                    self._pass_on(node)
                case ast.Subscript(value=ast.Name(id=name), slice=index):
                    if self.program.has_field(_last(index)):
                        f.fixed[name] = RECORD
                    f.indexed |= {(name, n.id) for n in _own(_last(index)) if isinstance(n, ast.Name)}
        if results:
            f.result = functools.reduce(merge, results)

    def _assign(self, target: ast.expr, kind: Kind) -> None:
        if isinstance(target, ast.Name):
            self.function.known[target.id] = merge(self.function.known.get(target.id, kind), kind)
        elif isinstance(target, ast.Tuple):
            parts = kind if isinstance(kind, tuple) and len(kind) == len(target.elts) else [kind] * len(target.elts)
            for part, one in zip(target.elts, parts, strict=True):
                self._assign(part, one)

    def _element(self, over: ast.expr) -> Kind:
        """Return the kind of what a loop gives."""
        if isinstance(over, ast.Call) and isinstance(over.func, ast.Name):
            if over.func.id == "zip":
                return tuple(self._element(a) for a in over.args)
            if over.func.id == "enumerate":
                return FREE, self._element(over.args[0])
            if over.func.id == "range":
                return FREE
        kind = self.kind(over)
        return kind if isinstance(kind, str) else join(*kind)

    def _pass_on(self, call: ast.Call) -> None:
        callee = self.program.resolve(self.function.module, call.func)
        if callee is None:
            return
        for name, argument in zip(callee.parameters, call.args, strict=False):
            if isinstance(argument, ast.Starred):
                break
            kind = self.kind(argument)
            if kind != UNKNOWN or self.function.module.path.startswith(("factors/", "fg_orient/kernels/")):
                callee.passed[name] = merge(callee.passed.get(name, kind), kind)
            row = isinstance(argument, ast.Subscript) and isinstance(argument.slice, ast.Name | ast.Subscript)
            base = argument.value if row else argument  # type: ignore[attr-defined]
            if callee.fixed.get(name) == RECORD and isinstance(base, ast.Name) and base.id not in self._tuples():
                self.function.fixed[base.id] = RECORD
        places = dict(zip(callee.parameters, call.args, strict=False))
        for array, index in callee.indexed & {(a, i) for a in places for i in places}:
            if isinstance(places[array], ast.Name):
                own = (n.id for n in _own(places[index]) if isinstance(n, ast.Name))
                self.function.indexed |= {(places[array].id, n) for n in own}  # type: ignore[attr-defined]

    def _tuples(self) -> set[str]:
        return {name for name, kind in self.function.known.items() if isinstance(kind, tuple)}

    def kind(self, node: ast.expr) -> Kind:
        """Return the kind of an expression."""
        program = self.program
        match node:
            case ast.Name(id=name):
                return self.function.kind(name)
            case ast.Tuple(elts=parts) | ast.List(elts=parts):
                return tuple(self.kind(p) for p in parts)
            case ast.Constant() | ast.Compare() | ast.JoinedStr():
                return FREE
            case ast.Attribute(attr=name, value=value):
                if name in RECORD_ATTRIBUTES:
                    return RECORD
                if name in FREE_ATTRIBUTES or program.is_field(node):
                    return FREE
                kind = self.kind(value)
                return kind if name in SAME or kind == FREE else UNKNOWN
            case ast.ListComp(elt=value):
                return RECORD if join(self.kind(value)) == RECORD else FREE
            case ast.BinOp(left=a, op=ast.MatMult(), right=b):
                return UNKNOWN if (kind := join(self.kind(a), self.kind(b))) == RECORD else kind
            case ast.BinOp(left=a, right=b):
                return join(self.kind(a), self.kind(b))
            case ast.UnaryOp(operand=value) | ast.Starred(value=value):
                return self.kind(value)
            case ast.IfExp(body=a, orelse=b):
                return merge(self.kind(a), self.kind(b))
            case ast.Subscript(value=value, slice=index):
                return self._part(value, self.kind(value), index)
            case ast.Call():
                return self._result(node)
        return UNKNOWN

    def _part(self, base: ast.expr, whole: Kind, index: ast.expr) -> Kind:
        """Return the kind of a subscript."""
        if isinstance(whole, tuple):
            one = isinstance(index, ast.Constant) and isinstance(index.value, int) and index.value < len(whole)
            return whole[index.value] if one else join(*whole)  # type: ignore[index]
        last = _last(index)
        if isinstance(last, ast.Constant) and isinstance(last.value, str):
            return UNKNOWN
        if whole != RECORD or isinstance(last, ast.Slice | ast.List):
            return whole
        if self.program.is_field(last):
            assert isinstance(last, ast.Attribute)
            record = _dotted(last.value)[-1]
            same = [size for (_, name), size in self.program.sizes.items() if name == last.attr]
            return FREE if self.program.sizes.get((record, last.attr), max(same, default=99)) <= 3 else RECORD
        return RECORD if self._is_batch(base) and not isinstance(index, ast.Tuple) else FREE  # a row, or a number

    def _result(self, call: ast.Call) -> Kind:
        """Return the kind of what a call gives."""
        callee = self.program.resolve(self.function.module, call.func)
        if callee is not None:
            return callee.result
        if isinstance(call.func, ast.Name) and self.function.kind(call.func.id) == FREE:
            return FREE
        parts = _dotted(call.func)
        method = parts[-1]
        if method == "records" or (method == "pack" and self.program.names & set(parts)):
            return RECORD
        if method in ("empty", "zeros", "ones", "full", "normal", "uniform", "eye") and call.args + call.keywords:
            return self._created(call)
        if method == "reshape" and isinstance(call.func, ast.Attribute):
            sizes = [n.value for a in call.args for n in ast.walk(a) if isinstance(n, ast.Constant)]
            if sizes and all(s <= 3 for s in sizes) and len(_flat(call.args)) == len(sizes) > 1:
                return FREE
        if method in SAME:
            own = [call.func.value] if isinstance(call.func, ast.Attribute) and parts[0] != "np" else []
            kinds = [self.kind(a) for a in (*own, *call.args)]
            if method == "array":
                return self._written(call.args[0], kinds[0])
            return join(*kinds[:1] if own else kinds)
        if parts[0] == "rng" or "linalg" in parts or method in FREE_CALLS:
            return FREE
        return join(*(self.kind(a) for a in call.args)) if parts[0] in ("np", "math") else UNKNOWN

    def _created(self, call: ast.Call) -> Kind:
        """Return the kind of an array that is created here.

        It is a record if its size is that of a record, and free if its size is written there.
        """
        if any(isinstance(n, ast.Attribute) and n.attr == "size" and _dotted(n.value)[-1] in self.program.names
               for n in ast.walk(call)):  # fmt: skip
            return RECORD
        shape = next((k.value for k in call.keywords if k.arg == "size"), call.args[0] if call.args else None)
        if isinstance(shape, ast.Constant):
            return FREE if isinstance(shape.value, int) and shape.value <= 4 else UNKNOWN
        return FREE if isinstance(shape, ast.Tuple) else UNKNOWN

    def _written(self, numbers: ast.expr, kind: Kind) -> Kind:
        """Return the array of numbers that are written there: up to three, or a matrix."""
        if isinstance(numbers, ast.List) and numbers.elts and not isinstance(kind, str):
            return FREE if len(kind) <= 3 or isinstance(numbers.elts[0], ast.List) else UNKNOWN
        return FREE if isinstance(kind, tuple) and len(kind) <= 3 else join(kind)

    def numbered(self, strict: bool) -> Iterator[tuple[int, str]]:
        """Yield the lines and texts of indices by integers."""
        for node in self.nodes:
            if isinstance(node, ast.Subscript):
                kind, last = self.kind(node.value), _last(node.slice)
                integers = _integers(last)
                if not integers or not isinstance(kind, str):
                    continue
                several = isinstance(node.slice, ast.Tuple)
                bad = kind == RECORD and not self._is_row(node, several)
                if strict and kind == UNKNOWN and not _is_neighbour(last):
                    bad = max(integers) > (2 if several else 0)
                if kind == FREE and isinstance(node.value, ast.Name) and not several:
                    bad = max(integers) > self.function.limits.get(node.value.id, 10**9)
                if bad:
                    yield node.lineno, ast.unparse(node)
            elif isinstance(node, ast.Call) and (callee := self.program.resolve(self.function.module, node.func)):
                places = dict(zip(callee.parameters, node.args, strict=False))
                for array, index in callee.indexed & {(a, i) for a in places for i in places}:
                    if self.kind(places[array]) == RECORD and _integers(places[index]):
                        yield node.lineno, ast.unparse(node)

    def _is_row(self, node: ast.Subscript, several: bool) -> bool:
        """Return whether a node is ``records[0]`` or ``records[:1]`` of a batch, or neighbours along its axes.

        An example of neighbours is ``knots[1:, :-1]``.
        """
        if several and isinstance(node.slice, ast.Tuple):
            return all(isinstance(i, ast.Slice) and _integers(i) == [1] for i in node.slice.elts)
        return self._is_batch(node.value) and max(_integers(node.slice)) <= 1

    def _is_batch(self, base: ast.expr) -> bool:
        """Return whether an array holds many records: an attribute ``records``, or an array with a second index."""
        if isinstance(base, ast.Call):
            return _dotted(base.func)[-1] == "records"
        name = _dotted(base)
        return name[-1] in ("records", "control_records") or any(
            isinstance(n, ast.Subscript) and isinstance(n.slice, ast.Tuple) and _dotted(n.value) == name
            for n in self.nodes
        )


def _flat(arguments: list[ast.expr]) -> list[ast.expr]:
    return [e for a in arguments for e in (a.elts if isinstance(a, ast.Tuple) else [a])]


def sources() -> dict[str, str]:
    """Return the text of every module that the check reads, by its path."""
    return {str(path.relative_to(ROOT)): path.read_text("utf-8")
            for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*.py"))}  # fmt: skip


def main() -> int:
    """Print all findings; return 1 if there are any."""
    found = list(dict.fromkeys(Program(sources()).findings(FOLDERS)))
    print("\n".join(found) or "records of constants are indexed by name")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
