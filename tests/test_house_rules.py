"""The house rules of CONTRIBUTING.md that a machine can check; each rule is first shown to notice its own breach."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from typing import TypeVar, cast

import pytest

from tests.support.golden_texts import golden_texts

ROOT = Path(__file__).parents[1]
PRODUCT = ("appliance", "drivers")
SHIPPED = (*PRODUCT, "hw_sim")
FRAGMENT = re.compile(
    r"\W*(Of|As|By|So|From|In|At|With|For|Where|What|Whose|How|Whether|On|Up|After|Before|Until|Onto|Per"
    r"|To|Over|Towards|Between|Along|Beside|Instead|Since|Their|They|When|Which|Below|Without|Within|Than)\b"
)

WALL_CLOCK = {"time.time", "time.time_ns", "datetime.now", "datetime.utcnow", "datetime.today", "date.today"}
ENDLESS = {"wait", "join", "result", "communicate"}
"""Methods that wait for ever when they are called without arguments."""
UNBOUNDED = {"Queue", "LifoQueue", "PriorityQueue", "JoinableQueue"}
SEEDED = {"default_rng", "SeedSequence", "PCG64", "Philox", "Random"}
QUANTITY = re.compile(
    r"(^|_)(time|timeout|delay|duration|interval|latency|age|distance|thickness|exposure|temperature|angle"
    r"|frequency|voltage)$"
)


Node = TypeVar("Node", bound=ast.AST)


@dataclass(frozen=True)
class Source:
    """One Python file."""

    path: str
    text: str

    @cached_property
    def tree(self) -> ast.Module:
        return ast.parse(self.text, self.path)

    @cached_property
    def _nodes(self) -> dict[type[ast.AST], list[ast.AST]]:
        nodes: dict[type[ast.AST], list[ast.AST]] = {}
        for node in ast.walk(self.tree):
            nodes.setdefault(type(node), []).append(node)
        return nodes

    def every(self, kind: type[Node]) -> list[Node]:
        """Every node of that very kind; the tree is walked once for all rules."""
        return cast(list[Node], self._nodes.get(kind, []))

    @cached_property
    def calls(self) -> list[tuple[ast.Call, str]]:
        """Every call with the dotted name of what is called, as far as it is names and attributes."""
        return [(node, dotted(node.func)) for node in self.every(ast.Call)]

    def lines_matching(self, pattern: str) -> Iterator[int]:
        if re.search(pattern, self.text):  # hardly a file has one
            for number, line in enumerate(self.text.splitlines(), 1):
                if re.search(pattern, line):
                    yield number


def dotted(node: ast.expr) -> str:
    match node:
        case ast.Name(id=name):
            return name
        case ast.Attribute(value=value, attr=name):
            return f"{dotted(value)}.{name}"
        case _:
            return "?"


Breach = tuple[int, str]


def no_docstring(source: Source) -> Iterator[Breach]:
    if not (ast.get_docstring(source.tree) or "").strip():
        yield 1, "the module has no docstring: say in a sentence what it does"


def wall_clock(source: Source) -> Iterator[Breach]:
    for call, name in source.calls:
        if ".".join(name.split(".")[-2:]) in WALL_CLOCK:
            yield call.lineno, f"{name}: wall time jumps; ask the clock that was handed in"
    yield from imported_from("time", {"time", "time_ns"}, source)


def sleep(source: Source) -> Iterator[Breach]:
    for call, name in source.calls:
        if name == "time.sleep":
            yield call.lineno, "time.sleep: ask the clock that was handed in, it decides how time passes"
    yield from imported_from("time", {"sleep"}, source)


def imported_from(module: str, names: set[str], source: Source) -> Iterator[Breach]:
    for node in source.every(ast.ImportFrom):
        if node.module == module:
            for alias in node.names:
                if alias.name in names:
                    yield node.lineno, f"from {module} import {alias.name} hides what is called"


def swallowed_error(source: Source) -> Iterator[Breach]:
    for node in source.every(ast.ExceptHandler):
        if node.type is None:
            yield node.lineno, "a bare except catches even the request to stop"
        elif dotted(node.type) in {"Exception", "BaseException"} and all(isinstance(s, ast.Pass) for s in node.body):
            yield node.lineno, "every error is swallowed: name the one that is expected"


def prints(source: Source) -> Iterator[Breach]:
    for call, name in source.calls:
        if name in {"print", "pprint", "pprint.pprint"}:
            yield call.lineno, "print: log it, return it or draw it"


def endless_wait(source: Source) -> Iterator[Breach]:
    for call, name in source.calls:
        receiver, _, method = name.rpartition(".")
        if receiver and method in ENDLESS and not call.args and not call.keywords:
            yield call.lineno, f"{name}() waits for ever: give it a timeout"


def unbounded_queue(source: Source) -> Iterator[Breach]:
    for call, name in source.calls:
        last = name.rpartition(".")[2]
        if last == "SimpleQueue" or (last in UNBOUNDED and not call.args and not call.keywords):
            yield call.lineno, f"{name}() grows without bound: give it a size and say what happens when it is full"


def unseeded_randomness(source: Source) -> Iterator[Breach]:
    for call, name in source.calls:
        parts = name.split(".")
        if parts[-1] in SEEDED and (parts[:-1] in ([], ["np", "random"], ["random"])):
            if not call.args and not call.keywords:
                yield call.lineno, f"{name}() without a seed"
        elif name in {"os.urandom", "uuid.uuid4"} or (
            parts[:-1] in (["np", "random"], ["random"], ["secrets"]) and parts[-1] != "Generator"
        ):
            yield call.lineno, f"{name}: cannot be repeated; draw from a seeded generator that was handed in"


def import_side_effect(source: Source) -> Iterator[Breach]:
    allowed = (
        *(ast.Import, ast.ImportFrom, ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef),
        *(ast.Assign, ast.AnnAssign, ast.AugAssign, ast.Pass),
    )
    for node in source.tree.body:
        match node:
            case ast.Expr(value=ast.Constant()):
                continue
            case ast.If(test=test) if ast.unparse(test) in {"TYPE_CHECKING", "__name__ == '__main__'"}:
                continue
            case ast.Expr(value=ast.Call(func=function)) if dotted(function) == "sys.exit":
                if source.path.endswith("__main__.py"):
                    continue
            case _ if isinstance(node, allowed):
                continue
        yield node.lineno, "something happens at import: put it into a function"


def global_state(source: Source) -> Iterator[Breach]:
    for node in source.every(ast.Global):
        yield node.lineno, f"global {', '.join(node.names)}: hand the state in"


def dataclass_without_slots(source: Source) -> Iterator[Breach]:
    for node in source.every(ast.ClassDef):
        for decorator in node.decorator_list:
            call = decorator.func if isinstance(decorator, ast.Call) else decorator
            if dotted(call) not in {"dataclass", "dataclasses.dataclass"}:
                continue
            keywords = decorator.keywords if isinstance(decorator, ast.Call) else []
            given = {k.arg for k in keywords if isinstance(k.value, ast.Constant) and k.value.value is True}
            if "slots" not in given:
                yield node.lineno, f"{node.name}: a misspelt attribute goes unnoticed without slots=True"


def field_without_unit(source: Source) -> Iterator[Breach]:
    for node in source.every(ast.ClassDef):
        if node.name.startswith("_") or not any("dataclass" in ast.unparse(d) for d in node.decorator_list):
            continue
        for item in node.body:
            match item:
                case ast.AnnAssign(target=ast.Name(id=name), annotation=kind):
                    if QUANTITY.search(name) and re.search(r"\b(float|int)\b", ast.unparse(kind)):
                        yield item.lineno, f"{node.name}.{name} is a quantity: name its unit (_ms, _mm, _c)"


def knows_the_simulator(source: Source) -> Iterator[Breach]:
    for number in source.lines_matching(r"(?i)hw_?sim|\b(is_)?simulat|\b(is_)?(mock|fake)|\bis_real\b"):
        yield number, "product code does not know whether the world around it is simulated"


def postponed(source: Source) -> Iterator[Breach]:
    for number in source.lines_matching(r"#.*\b(TODO|FIXME|XXX|HACK)\b"):
        yield number, "do it, or write it down where plans are kept"


def blanket_silence(source: Source) -> Iterator[Breach]:
    for number in source.lines_matching(r"#\s*(type:\s*ignore(?!\[)|noqa(?!:))"):
        yield number, "silences every message: name the one that is meant"


def fragment_docstring(source: Source) -> Iterator[Breach]:
    """Docstrings of modules, classes and functions, and the strings below fields and constants."""
    scopes: list[ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef] = [source.tree]
    scopes += source.every(ast.ClassDef)
    scopes += source.every(ast.FunctionDef)
    scopes += source.every(ast.AsyncFunctionDef)
    for scope in scopes:
        for one in scope.body:
            match one:
                case ast.Expr(value=ast.Constant(value=str(text))) if found := FRAGMENT.match(text):
                    yield one.lineno, f"a sentence that begins with {found[1]!r} needs the line above to be understood"


def asserts_nothing(source: Source) -> Iterator[Breach]:
    for node in source.every(ast.FunctionDef):
        if node.name.startswith("test_"):
            if any(ast.unparse(d).startswith("given(") for d in node.decorator_list):
                continue  # that no input raises anything unexpected is what it asserts
            asserts = any(isinstance(inner, ast.Assert) for inner in ast.walk(node))
            called = {dotted(c.func).rpartition(".")[2] for c in ast.walk(node) if isinstance(c, ast.Call)}
            if not asserts and not any(
                re.match(r"_?(assert|check|expect|raises|fail|warns|says)", name) for name in called
            ):
                yield node.lineno, f"{node.name} asserts nothing"


def unchecked_generator(source: Source) -> Iterator[Breach]:
    for call, name in source.calls:
        if name.rpartition(".")[2] in {"builds", "from_type"}:
            yield call.lineno, f"{name}() hands on fields of any type: use tests.support.typed.built"


def open_match(source: Source) -> Iterator[Breach]:
    for node in source.every(ast.Match):
        last = node.cases[-1]
        if last.guard is not None or not isinstance(last.pattern, ast.MatchAs) or last.pattern.pattern is not None:
            yield node.lineno, "what fits no case passes in silence: end with `case unknown: assert_never(unknown)`"


def leans_on_measurements(source: Source) -> Iterator[Breach]:
    imported = [(node.lineno, name.name) for node in source.every(ast.Import) for name in node.names]
    imported += [(node.lineno, node.module or "") for node in source.every(ast.ImportFrom) if not node.level]
    for line, module in imported:
        if module.partition(".")[0] == "bench":
            yield line, f"{module}: what tests and measurements share belongs in tests.support"


@dataclass(frozen=True)
class Rule:
    """A check, where it holds, and an example that it must notice beside one that it must let pass.

    ``except_in`` names the files (or folders, with a final slash) where it does not hold, ``except_calls`` the calls
    that it may not judge; each with the reason.
    """

    check: Callable[[Source], Iterator[Breach]]
    bad: tuple[str, ...]
    good: tuple[str, ...]
    packages: tuple[str, ...] = SHIPPED
    except_in: dict[str, str] = field(default_factory=dict)
    except_calls: dict[str, str] = field(default_factory=dict)

    def breaches(self, source: Source) -> list[Breach]:
        return [b for b in self.check(source) if not any(b[1].startswith(f"{name}(") for name in self.except_calls)]


RULES = [
    Rule(no_docstring, bad=("x = 1", '""" """'), good=('"""Draw x."""',)),
    Rule(
        wall_clock,
        bad=("time.time()", "datetime.datetime.now(UTC)", "datetime.now()", "from time import time"),
        good=("clock.now_ns()", "time.monotonic()"),
        except_in={
            "drivers/wall_clock.py": "the instrument's calendar, by which nothing is decided",
            "hw_sim/timing/calendar.py": "the simulated one begins today",
            "appliance/cli/calibration.py": "the date in a calibration file",
            "appliance/cli/calibrate_air.py": "the same",
            "appliance/cli/calibrate_water.py": "the same",
        },
    ),
    Rule(
        sleep,
        bad=("time.sleep(1)", "from time import sleep"),
        good=("clock.sleep_s(1)",),
        except_in={"drivers/native.py": "the clock of the instrument"},
    ),
    Rule(
        swallowed_error,
        bad=("try: f()\nexcept: g()", "try: f()\nexcept Exception: pass"),
        good=("try: f()\nexcept OSError: pass", "try: f()\nexcept Exception as e: log(e)"),
    ),
    Rule(prints, bad=("print(x)",), good=("sys.stdout.write(x)",)),
    Rule(
        endless_wait,
        bad=("event.wait()", "self.thread.join()", "future.result()"),
        good=("event.wait(1.0)", "thread.join(timeout=2)", "', '.join(names)", "pacer.wait(clock)"),
        except_calls={
            "self._pacer.wait": "a pacer computes its own deadline",
            "self._drive.join": "the world's drive bounds its own end",
            "pending.result": "asked only once it is done",
            "answer.result": "asked only once it is done",
            "scan.raw.result": "asked behind it, in the same one thread",
        },
    ),
    Rule(
        unbounded_queue,
        bad=("queue.Queue()", "Queue()", "SimpleQueue()"),
        good=("queue.Queue(8)", "Queue(maxsize=8)"),
    ),
    Rule(
        unseeded_randomness,
        bad=("np.random.default_rng()", "np.random.normal(0, 1)", "random.random()", "Random()", "os.urandom(4)"),
        good=("np.random.default_rng(7)", "rng.normal(0, 1)", "default_rng(seed)", "np.random.Generator(bits)"),
    ),
    Rule(
        import_side_effect,
        bad=("open('x')", "for i in y: f(i)", "if DEBUG: f()", "with x: pass"),
        good=('"""Doc."""\nimport os\nX = f()\nclass A: pass', "if TYPE_CHECKING:\n    import os"),
    ),
    Rule(global_state, bad=("def f():\n    global x\n    x = 1",), good=("def f():\n    nonlocal_x = 1",)),
    Rule(
        dataclass_without_slots,
        bad=("@dataclass\nclass A: pass", "@dataclasses.dataclass(frozen=True)\nclass A: pass"),
        good=("@dataclass(frozen=True, slots=True)\nclass A: pass", "class A: pass"),
    ),
    Rule(
        field_without_unit,
        bad=("@dataclass\nclass A:\n    exposure: float", "@dataclass\nclass A:\n    read_timeout: float | None"),
        good=("@dataclass\nclass A:\n    exposure_us: float\n    age_s: float", "class A:\n    exposure: float"),
    ),
    Rule(
        knows_the_simulator,
        bad=("import hw_sim", "if self.simulated: pass", "is_fake = 1", "# only when simulating"),
        good=("similar = 1", "dissimulate = 2"),
        packages=PRODUCT,
        except_in={
            "appliance/cli/": "the verb `sim` finds the simulator by name and hands its options on unread",
            "drivers/aravis/library.py": "Aravis calls one of its interfaces so",
            "drivers/registered_wires.py": "the list of names that a rig file may give; nothing is decided by it",
        },
    ),
    Rule(
        postponed,
        bad=("x = 1  # TODO later",),
        good=("x = 'TODO'",),
        packages=(*SHIPPED, "bench", "tests"),
        except_in={"tests/test_house_rules.py": "the example above"},
    ),
    Rule(
        blanket_silence,
        bad=("x = y  # type: ignore", "x = y  # noqa"),
        good=("x = y  # type: ignore[attr-defined]", "x = y  # noqa: N802"),
        packages=(*SHIPPED, "bench", "tests"),
        except_in={"tests/test_house_rules.py": "the example above"},
    ),
    Rule(
        fragment_docstring,
        bad=(
            '"""What is drawn."""',
            'x = 1.0\n"""Of the sum."""',
            'def f():\n    """Whether it may."""',
            'class A:\n    x: int\n    """By its number."""',
        ),
        good=(
            '"""Draw x."""',
            'x = 1.0\n"""Limit of the sum."""',
            'def f():\n    """Tell whether it may."""',
            'f("As it is")',
            '"""Inside."""',
        ),
    ),
    Rule(
        asserts_nothing,
        bad=("def test_x():\n    f()",),
        good=("def test_x():\n    assert f()", "def test_x():\n    with pytest.raises(E): f()", "def f(): pass"),
        packages=("tests",),
    ),
    Rule(
        unchecked_generator,
        bad=("st.builds(Fault, st.just(3))", "builds(Fault)"),
        good=("built(Fault, st.just('x'))", "st.just(1)"),
        packages=("tests",),
        except_in={"tests/support/typed.py": "it checks what was built"},
    ),
    Rule(
        open_match,
        bad=("match x:\n    case 1: f()", "match x:\n    case 1: f()\n    case _ if g: h()"),
        good=("match x:\n    case 1: f()\n    case _: pass", "match x:\n    case 1: f()\n    case y: assert_never(y)"),
        packages=("appliance", "drivers"),
    ),
    Rule(
        leans_on_measurements,
        bad=(
            "import bench",
            "import os, bench.bias as b",
            "from bench import bias",
            "def f():\n    from bench.bias import rms",
        ),
        good=(
            "import benchmark",
            "from tests.bench import x",
            "from .bench import x",
            "bench = 1",
            "bench.bias.rms(x)",
        ),
        packages=("tests",),
        except_in={"tests/bench/": "the tests of the measurements themselves"},
    ),
]


def sources(package: str) -> Iterator[Source]:
    for path in sorted((ROOT / package).rglob("*.py")):
        yield Source(path.relative_to(ROOT).as_posix(), path.read_text(encoding="utf-8"))


def name_of(rule: Rule) -> str:
    return rule.check.__name__.replace("_", "-")


@cache
def breaches_of_all_rules() -> dict[str, list[tuple[str, int, str]]]:
    """Path, line and message of every breach, by the rule's name, also where the rule does not hold.

    One file after the other meets all rules: the trees of all at once take half a gigabyte and long to go through.
    """
    found: dict[str, list[tuple[str, int, str]]] = {name_of(rule): [] for rule in RULES}
    for package in sorted({package for rule in RULES for package in rule.packages}):
        rules = [rule for rule in RULES if package in rule.packages]
        for source in sources(package):
            for rule in rules:
                found[name_of(rule)] += [(source.path, *breach) for breach in rule.breaches(source)]
    return found


@pytest.mark.parametrize("rule", RULES, ids=name_of)
def test_the_rule_notices_its_breach_and_nothing_else(rule: Rule) -> None:
    for example in rule.bad:
        assert rule.breaches(Source("example.py", example)), f"not noticed: {example}"
    for example in rule.good:
        assert not rule.breaches(Source("example.py", example)), f"wrongly noticed: {example}"


@pytest.mark.parametrize("rule", RULES, ids=name_of)
def test_the_rule_is_kept(rule: Rule) -> None:
    found = [
        f"{path}:{line}: {message}"
        for path, line, message in breaches_of_all_rules()[name_of(rule)]
        if not path.startswith(tuple(rule.except_in))
    ]
    assert not found, "\n" + "\n".join(found)


@pytest.mark.parametrize("rule", [rule for rule in RULES if rule.except_in], ids=name_of)
def test_no_exception_outlives_its_reason(rule: Rule) -> None:
    for excepted in rule.except_in:
        breaches = [path for path, _, _ in breaches_of_all_rules()[name_of(rule)] if path.startswith(excepted)]
        assert breaches, f"{excepted} no longer needs to be excepted from {name_of(rule)}"


def homonyms(package: Iterable[Source]) -> dict[str, list[str]]:
    """The names of classes that stand in more than one file of a room, with these files; private ones are nobody else's.

    A room is a folder directly below a root, with everything in it; what lies loose below the root is one, too.
    """
    where: dict[tuple[str, ...], list[str]] = {}
    for source in package:
        room = source.path.split("/")[:-1][:2]
        for name in re.findall(r"^class ([^\W_]\w*)", source.text, re.MULTILINE):
            where.setdefault((*room, name), []).append(source.path)
    return {"/".join(key): paths for key, paths in where.items() if len(paths) > 1}


def test_the_rule_of_homonyms_notices_its_breach_and_nothing_else() -> None:
    seen = "class Seen: pass"
    one, deeper, loose = (Source(path, seen) for path in ("drivers/a/one.py", "drivers/a/b/two.py", "drivers/one.py"))
    assert homonyms([one, deeper, loose]) == {"drivers/a/Seen": ["drivers/a/one.py", "drivers/a/b/two.py"]}
    assert homonyms([loose, Source("drivers/two.py", seen)]) == {"drivers/Seen": ["drivers/one.py", "drivers/two.py"]}
    next_door = Source("drivers/c/one.py", seen)
    private = Source("drivers/a/private.py", "class _Seen: pass\nSeen = 1\ndef f():\n    class Seen: pass")
    assert not homonyms([one, loose, next_door, private, private])


@pytest.mark.parametrize("root", SHIPPED)
def test_a_class_has_a_name_of_its_own_in_its_room(root: str) -> None:
    found = homonyms(sources(root))
    assert not found, "\n".join(f"{name}: {', '.join(paths)}" for name, paths in found.items())


def test_every_golden_text_belongs_to_a_test() -> None:
    for key in golden_texts():
        path, _, name = key.partition("::")
        test = re.split(r"[\[ ]", name)[0]
        assert re.search(rf"def {test}\b", (ROOT / path).read_text(encoding="utf-8")), f"{key}: no such test"
