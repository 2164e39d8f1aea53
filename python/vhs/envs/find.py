"""Finding a `Task` where a person says that it is: in a Python file, or in a module."""

from __future__ import annotations

import hashlib
import sys
from functools import lru_cache
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

from vhs.asking import what_happened
from vhs.errors import ConfigError
from vhs.task import Task


def task_in_file(path: Path, name: str) -> Task:
    """The task of a name in a Python file, which is run once.

    Raises:
        ConfigError: There is no such file, it cannot be run, or it has no task of that name.
    """
    if not path.is_file():
        raise ConfigError(
            f"task: expected the file {path}, found none; if it has moved, say where to: --task {path.name}"
        )
    path = path.resolve()
    return _task_of(_module_of(path, path.stat().st_mtime_ns), name, f"{path}")


def task_in_module(module: str, name: str) -> Task:
    """The task of a name in a module that Python can import.

    Raises:
        ConfigError: It cannot be imported, or has no task of that name.
    """
    try:
        found = import_module(module)
    except Exception as error:  # whatever the module of a user does when it is run
        raise ConfigError(f"task: expected the module {module}, found {what_happened(error)}") from error
    return _task_of(found, name, module)


@lru_cache
def _module_of(path: Path, _changed_ns: int) -> ModuleType:
    # A name that no other file has, and that pickles of its classes find again in this process.
    name = f"{path.stem}_{hashlib.sha256(str(path).encode()).hexdigest()[:8]}"
    spec = spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[name] = module_from_spec(spec)
    # What lies beside a program can be imported by it, and this is one.
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # whatever the file of a user does when it is run
        del sys.modules[name]
        raise ConfigError(
            f"task: expected a Python file that runs, {path}: found {what_happened(error)}"
        ) from error
    return module


def _task_of(module: ModuleType, name: str, where: str) -> Task:
    found = getattr(module, name, None)
    if isinstance(found, Task):
        return found
    tasks = [key for key, value in vars(module).items() if isinstance(value, Task)]
    hint = f"; it has {', '.join(tasks)}: say {where}:{tasks[0]}" if tasks else ""
    kind = "none" if found is None else f"a {type(found).__name__}"
    raise ConfigError(f"task: expected a vhs.Task called `{name}` in {where}, found {kind}{hint}")
