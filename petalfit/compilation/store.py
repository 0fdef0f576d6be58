"""Executables in a folder: a second process neither traces nor compiles what the first one did."""

from __future__ import annotations

import contextvars
import functools
import hashlib
import os
import pickle
import platform
from collections.abc import Callable, Hashable, Iterator
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

# A third to a half less to wait for, and programs just as fast.
_OPTIONS = {"xla_llvm_disable_expensive_passes": True, "xla_cpu_use_fusion_emitters": False}

# Packages whose classes and functions are told apart by petalfit's source and by versions.
_KNOWN = {"petalfit", "equinox", "jax", "jaxlib", "lineax", "numpy", "optimistix", "builtins"}

_DIGEST = hashlib.sha256().digest_size
# Models of classes that pickle cannot find again, and what XLA does not serialise.
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
    """Compiled programs in memory and in a folder.

    A file is named by all that a program depends on: petalfit's source, the versions of what traces
    and compiles it, and the structure, shapes and types of the arguments. A program of a function
    or a class of somebody else's is in memory only: nothing says when its source changes. Files of
    programs that nobody asks for any more are left to whoever owns the folder, and so is the choice
    of a folder for each kind of processor. Reading a file can run anything: the folder must be the
    user's alone. A folder that cannot be used costs time and nothing else.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._loaded: dict[Hashable, Callable] = {}

    def call(self, function: Callable, args: tuple) -> Any:
        """What a function gives for arguments, by its compiled form for arguments like these."""
        leaves, structure = jax.tree.flatten(args)
        forms = tuple(map(_form, leaves))
        # Within a process objects will do; the name of a file takes a hundred times as long.
        like = function, structure, forms, _double()
        if like not in self._loaded:
            with stage("compiling"):
                known = _is_known(function, structure)
                key = _key(function, structure, forms) if known else None
                kept = None if key is None else self._load(key)
                self._loaded[like] = kept or self._compile(key, function, args)
        return self._loaded[like](*leaves)

    def _load(self, key: str) -> Callable | None:
        with suppress(*_NOT_KEPT):
            content = (self.folder / key).read_bytes()
            if hashlib.sha256(content[_DIGEST:]).digest() == content[:_DIGEST]:
                _initialise()
                serialised, example = pickle.loads(content[_DIGEST:])
                compiled = serialize_executable.deserialize_and_load(*serialised)
                return _structured(compiled, jax.tree.structure(example))
        return None

    def _compile(self, key: str | None, function: Callable, args: tuple) -> Callable:
        """A program, and a file of it under its key if it has one."""
        leaves, structure = jax.tree.flatten(args)
        results = []

        # From leaves to leaves, because the structure of a model does not survive pickling; a model does.
        def flat(*leaves: object) -> list:
            result = function(*jax.tree.unflatten(structure, leaves))
            results.append(jax.tree.structure(result))
            return jax.tree.leaves(result)

        compiled = jax.jit(flat, compiler_options=options()).lower(*leaves).compile()
        (result,) = results
        if key is None:
            return _structured(compiled, result)
        # What came out of jax's own cache cannot always be serialised, and need not be.
        with suppress(*_NOT_KEPT):
            example = jax.tree.unflatten(result, range(result.num_leaves))
            content = pickle.dumps((serialize_executable.serialize(compiled), example))
            with atomic_path(self.folder / key) as path:
                path.write_bytes(hashlib.sha256(content).digest() + content)
        return _structured(compiled, result)


def _structured(compiled: Callable[..., list], structure: Any) -> Callable:
    """A program that gives leaves, with its results in their structure."""

    def call(*leaves: object) -> object:
        return jax.tree.unflatten(structure, compiled(*leaves))

    return call


@functools.cache
def options() -> dict[str, bool]:
    """Options for the compiler, as far as this one knows them: they come and go with its versions."""
    known = {}
    for name, value in _OPTIONS.items():
        with suppress(jax.errors.JaxRuntimeError):
            trial = jax.jit(lambda x: x, compiler_options={name: value})
            trial.lower(jax.ShapeDtypeStruct((), jnp.float32)).compile()
            known[name] = value
    return known


_current: contextvars.ContextVar[ExecutableStore | None] = contextvars.ContextVar(
    "store", default=None
)


def current_store() -> ExecutableStore | None:
    """The store in use, if any."""
    return _current.get()


@contextmanager
def use_store(store: ExecutableStore | None) -> Iterator[None]:
    """While the block runs, programs come from `store` and go there."""
    token = _current.set(store)
    try:
        yield
    finally:
        _current.reset(token)


@functools.cache
def _store_at(folder: Path) -> ExecutableStore:
    """One for the life of a process: what it has loaded stays."""
    return ExecutableStore(folder)


def use_folder(folder: Path | None) -> AbstractContextManager[None]:
    """While the block runs, programs come from a folder and go there; as before if there is none."""
    return nullcontext() if folder is None else use_store(_store_at(folder))


def _is_known(function: Callable, structure: Any) -> bool:
    """Whether a key tells all sources that a program of such arguments comes from."""
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
        str(_double()),
    ]
    digest = hashlib.sha256("\n".join(described).encode()).hexdigest()
    return f"{function.__name__.strip('_')}-{digest[:32]}"


def _double() -> bool:
    return jax.config.jax_enable_x64  # pyright: ignore[reportAttributeAccessIssue]


def _form(leaf: Any) -> tuple[object, ...]:
    weak = type(leaf) in (bool, int, float) or getattr(leaf, "weak_type", False)
    kind = leaf.dtype if isinstance(leaf, jax.Array | np.ndarray) else np.asarray(leaf).dtype
    return np.shape(leaf), kind.str, weak


@functools.cache
def _versions() -> str:
    """Digest of petalfit's own source, and versions of the packages that its programs come from."""
    source = hashlib.sha256()
    for path in sorted(Path(__file__).parents[1].rglob("*.py")):
        source.update(path.read_bytes())
    packages = "equinox", "jax", "jaxlib", "lineax", "numpy", "optimistix"
    versions = [f"{package} {version(package)}" for package in packages]
    return "\n".join([source.hexdigest(), platform.python_version(), *versions])


@functools.cache
def _initialise() -> None:
    """Loaded executables call LAPACK, whose entry points jax looks up when it first lowers a call."""
    jax.jit(jnp.linalg.cholesky).lower(jax.ShapeDtypeStruct((1, 1), jnp.float32))
