"""Executables in a folder: a second process need not trace and compile what the first one did."""

from __future__ import annotations

import contextvars
import functools
import hashlib
import os
import pickle
import platform
import threading
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental import serialize_executable

from petalfit.compilation.stopwatch import stage
from petalfit.observations.atomic import atomic_path

# With these, compilation takes a third to a half less time, and programs are just as fast.
_OPTIONS = {"xla_llvm_disable_expensive_passes": True, "xla_cpu_use_fusion_emitters": False}

# Packages whose classes and functions are identified by petalfit's source and by package versions.
_KNOWN = {"petalfit", "equinox", "jax", "jaxlib", "lineax", "numpy", "optimistix", "builtins"}

_DIGEST = hashlib.sha256().digest_size
# Errors of models whose classes pickle cannot find again, and of programs that XLA cannot serialise.
_NOT_KEPT = (
    OSError,
    ValueError,
    NotImplementedError,
    AttributeError,
    TypeError,
    pickle.PicklingError,
    jax.errors.JaxRuntimeError,
)


class ExecutableStore:
    """Compiled programs in memory and, unless it is None, in a folder.

    The name of a file is a digest of all that a program depends on: petalfit's source, the versions of
    the packages that trace and compile it, and the structure, shapes and types of the arguments. A
    program with functions or classes of unknown packages is kept in memory only, because changes of
    their source would go unnoticed. The folder's owner has to remove files that are no longer used, and
    to choose a folder for each kind of processor. Reading a file can run any code, so only the user may
    have access to the folder. A folder that cannot be used only costs time.
    """

    def __init__(self, folder: Path | None) -> None:
        self.folder = folder
        self._loaded: dict[Hashable, Callable] = {}
        self._locks: dict[Hashable, threading.Lock] = {}

    def program(self, function: Callable, structure: Any, leaves: Sequence) -> Callable:
        """The program of a function for arguments of a structure, with such leaves.

        It takes the leaves, and returns the function's result.
        """
        forms = _forms(leaves)
        # Objects suffice as keys within a process; the name of a file takes a hundred times as long.
        like = function, structure, forms, is_double()
        if like in self._loaded:
            return self._loaded[like]
        # Of threads that need the same program, one compiles it.
        with stage("compiling"), self._locks.setdefault(like, threading.Lock()):
            if like not in self._loaded:
                known = self.folder is not None and _is_known(function, structure)
                key = _key(function, structure, forms) if known else None
                kept = None if key is None else self._load(key)
                packed = kept or self._compile(key, function, structure, forms, leaves)
                self._loaded[like] = lambda *leaves: packed(*_packed(forms, leaves))
        return self._loaded[like]

    def _load(self, key: str) -> Callable | None:
        assert self.folder is not None
        with suppress(*_NOT_KEPT):
            content = (self.folder / key).read_bytes()
            if hashlib.sha256(content[_DIGEST:]).digest() == content[:_DIGEST]:
                _initialise()
                serialised, example = pickle.loads(content[_DIGEST:])
                compiled = serialize_executable.deserialize_and_load(*serialised)
                return _structured(compiled, jax.tree.structure(example))
        return None

    def _compile(
        self, key: str | None, function: Callable, structure: Any, forms: tuple, leaves: Sequence
    ) -> Callable:
        """Compiles a program, and saves it under its key if it has one."""
        results = []

        # The program maps leaves to leaves: a model can be pickled, but the structure of one cannot.
        def flat(scalars: jax.Array, *others: object) -> list:
            first, rest = iter(scalars), iter(others)
            leaves = [next(first if form == _SCALAR else rest) for form in forms]
            result = function(*jax.tree.unflatten(structure, leaves))
            results.append(jax.tree.structure(result))
            return jax.tree.leaves(result)

        jitted = jax.jit(flat, compiler_options=options())
        compiled = jitted.lower(*_packed(forms, leaves)).compile()
        (result,) = results
        if key is None or self.folder is None:
            return _structured(compiled, result)
        # A program from jax's own cache cannot always be serialised, and need not be.
        with suppress(*_NOT_KEPT):
            example = jax.tree.unflatten(result, range(result.num_leaves))
            content = pickle.dumps((serialize_executable.serialize(compiled), example))
            with atomic_path(self.folder / key) as path:
                path.write_bytes(hashlib.sha256(content).digest() + content)
        return _structured(compiled, result)


def _packed(forms: tuple, leaves: Sequence) -> list:
    """The leaves that are doubles, in one array, because each argument takes time; then the others."""
    scalars, others = [], []
    for form, leaf in zip(forms, leaves, strict=True):
        (scalars if form == _SCALAR else others).append(leaf)
    return [np.array(scalars, np.float64), *others]


def _structured(compiled: Callable[..., list], structure: Any) -> Callable:
    """Wraps a program that returns leaves, so that it returns results in their structure."""

    def call(*leaves: object) -> object:
        return jax.tree.unflatten(structure, compiled(*leaves))

    return call


@functools.cache
def options() -> dict[str, bool]:
    """The compiler options that the installed version knows; they come and go with versions."""
    known = {}
    for name, value in _OPTIONS.items():
        with suppress(jax.errors.JaxRuntimeError):
            trial = jax.jit(lambda x: x, compiler_options={name: value})
            trial.lower(jax.ShapeDtypeStruct((), jnp.float32)).compile()
            known[name] = value
    return known


_SCALAR = (), "<f8", False  # the form of a double
_IN_MEMORY = ExecutableStore(None)
_current: contextvars.ContextVar[ExecutableStore] = contextvars.ContextVar(
    "store", default=_IN_MEMORY
)


def current_store() -> ExecutableStore:
    """The store in use; one without a folder if no other one is."""
    return _current.get()


@contextmanager
def use_store(store: ExecutableStore) -> Iterator[None]:
    """Makes a block of code load programs from `store` and save them there."""
    token = _current.set(store)
    try:
        yield
    finally:
        _current.reset(token)


@functools.cache
def _store_at(folder: Path) -> ExecutableStore:
    """The store of a folder; one for the life of the process, so that loaded programs stay in memory."""
    return ExecutableStore(folder)


def use_folder(folder: Path | None) -> AbstractContextManager[None]:
    """Makes a block of code load programs from a folder and save them there; no change for None."""
    return nullcontext() if folder is None else use_store(_store_at(folder))


def _is_known(function: Callable, structure: Any) -> bool:
    """Whether a key covers the source of all functions and classes that a program depends on."""
    open_, modules = [structure], {function.__module__}
    while open_:
        node = open_.pop()
        data = node.node_data()
        modules |= {data[0].__module__} if data is not None else set()
        open_ += node.children()
    return {module.partition(".")[0] for module in modules} <= _KNOWN


def _key(function: Callable, structure: Any, forms: tuple) -> str:
    described = [
        _versions(),
        f"{function.__module__}.{function.__qualname__}",
        str(structure),
        str([*forms]),
        jax.default_backend(),
        os.environ.get("XLA_FLAGS", ""),
        str(is_double()),
    ]
    digest = hashlib.sha256("\n".join(described).encode()).hexdigest()
    return f"{function.__name__.strip('_')}-{digest[:32]}"


def is_double() -> bool:
    """Whether jax computes in double precision, in this thread."""
    return jax.config.jax_enable_x64  # pyright: ignore[reportAttributeAccessIssue]


def _forms(leaves: Sequence) -> tuple[tuple[object, ...], ...]:
    """The shape and the type of every leaf, and whether its type is weak."""
    forms = []
    for leaf in leaves:
        if type(leaf) is np.ndarray:
            forms.append((leaf.shape, leaf.dtype.str, False))
            continue
        weak = type(leaf) in (bool, int, float) or getattr(leaf, "weak_type", False)
        kind = leaf.dtype if isinstance(leaf, jax.Array | np.ndarray) else np.asarray(leaf).dtype
        forms.append((np.shape(leaf), kind.str, weak))
    return tuple(forms)


@functools.cache
def _versions() -> str:
    """The digest of petalfit's own source, and the versions of the packages that its programs use."""
    source = hashlib.sha256()
    for path in sorted(Path(__file__).parents[1].rglob("*.py")):
        source.update(path.read_bytes())
    packages = "equinox", "jax", "jaxlib", "lineax", "numpy", "optimistix"
    versions = [f"{package} {version(package)}" for package in packages]
    return "\n".join([source.hexdigest(), platform.python_version(), *versions])


@functools.cache
def _initialise() -> None:
    """Makes jax look up LAPACK, which loaded executables call and jax finds when it lowers a call."""
    jax.jit(jnp.linalg.cholesky).lower(jax.ShapeDtypeStruct((1, 1), jnp.float32))
