"""Reference pages that are made from the code: the command line, the configuration, the errors."""

import argparse
import ast
import inspect
import re
import textwrap
from collections.abc import Iterator
from typing import Any

import yaml
from pydantic import BaseModel
from pydantic.fields import FieldInfo

import vhs
from vhs import cli
from vhs import errors as python_errors
from vhs.config.schema import DECIDED_BY_TASK, Config, Of
from vhs.learning.methods import METHODS

_WIDTH = 118
_WHOLE: Any = {"break_on_hyphens": False, "break_long_words": False}
"""How text is wrapped: a word or a command stays whole."""


def command_line() -> str:
    """Every command with its arguments, from the parser."""
    parser = cli._parser()
    (commands,) = (action for action in parser._actions if isinstance(action, argparse._SubParsersAction))
    helps = {choice.dest: choice.help or "" for choice in commands._choices_actions}
    parts = []
    for name, command in commands.choices.items():
        command.prog = f"vhs {name}"
        arguments = [action for action in command._actions if action.dest != "help"]
        usage = f"vhs {name} {' '.join(_usage(action) for action in arguments)}"
        shown = textwrap.fill(usage, 88, subsequent_indent=" " * (len(name) + 5), break_on_hyphens=False)
        items = "\n\n".join(_item(_call(action), action.help or "") for action in arguments)
        parts.append(f"## vhs {name}\n{_sentence(helps[name])}\n\n```text\n{shown}\n```\n\n{items}")
    return "\n\n".join(parts)


def _usage(action: argparse.Action) -> str:
    """How an argument stands in a line of usage; spaces inside of it do not break."""
    text = _call(action).replace(" ", "\N{NO-BREAK SPACE}")
    if not action.option_strings:
        return f"{text}..." if action.nargs == "+" else text
    return f"[{text}]"


def _call(action: argparse.Action) -> str:
    metavar = str(action.metavar or action.dest)
    if not action.option_strings:
        return metavar
    return action.option_strings[0] + ("" if action.nargs == 0 else f" {metavar}")


def configuration() -> str:
    """Every key of the configuration, from the schema: default, meaning, the methods that read it."""
    top = [(key, field) for key, field in Config.model_fields.items() if not _is_section(field)]
    parts = [f"## Of the run\n{_documentation(Config)[0]}\n\n{_keys('', Config, top)}"]
    for section, field in Config.model_fields.items():
        if _is_section(field):
            kind = field.annotation
            keys = _keys(f"{section}.", kind, list(kind.model_fields.items()))
            parts.append(f"## {section}\n{_documentation(kind)[0]}\n\n{keys}")
    return "\n\n".join(parts)


def _is_section(field: FieldInfo) -> bool:
    return inspect.isclass(field.annotation) and issubclass(field.annotation, BaseModel)


def _keys(prefix: str, kind: type[BaseModel], fields: list[tuple[str, FieldInfo]]) -> str:
    said = _documentation(kind)[1]
    lines = []
    for name, field in fields:
        key = f"{prefix}{name}"
        default = _yaml(field.get_default(call_default_factory=True))
        decided = ", which the task decides" if key in DECIDED_BY_TASK else ""
        readers = [of for of in field.metadata if isinstance(of, Of)]
        methods = [n for n, row in METHODS.items() if any(_reads(of, row) for of in readers)]
        read = f" Read by {', '.join(methods)}." if readers else ""
        lines.append(_item(f"{key}: {default}", f"{said[name]}{read}", decided))
    return "\n\n".join(lines)


def _yaml(value: Any) -> str:
    plain = list(value) if isinstance(value, tuple) else value
    return yaml.safe_dump(plain, default_flow_style=True).removesuffix("\n...\n").strip()


def _reads(of: Of, row: Any) -> bool:
    return any(of.is_read(row.parts(row.fixed.get("embedding", name))) for name in ("prototype", "word"))


def _documentation(kind: type) -> tuple[str, dict[str, str]]:
    """What a class says of itself, and of each of its fields in the string below it."""
    (tree,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
    assert isinstance(tree, ast.ClassDef)
    said = {}
    for above, below in zip(tree.body, tree.body[1:], strict=False):
        match above, below:
            case (
                ast.AnnAssign(target=ast.Name(id=name)),
                ast.Expr(value=ast.Constant(value=str(text))),
            ):
                said[name] = _plain(text)
    return _plain(inspect.getdoc(kind) or ""), said


def errors() -> str:
    """Every error a user can meet, with what it is to Python."""
    found = [*_of(vhs), *(error for error in _of(python_errors) if error not in set(_of(vhs)))]
    return "\n\n".join(_item(error.__name__, error.__doc__ or "", f" ({_builtin(error)})") for error in found)


def _of(module: Any) -> Iterator[type[Exception]]:
    for name in module.__all__:
        kind = getattr(module, name)
        if inspect.isclass(kind) and issubclass(kind, Exception):
            yield kind


def _builtin(error: type[Exception]) -> str:
    bases = [base.__name__ for base in error.__bases__]
    return " and ".join(f"{'an' if base[0] in 'AEIOU' else 'a'} `{base}`" for base in bases)


def _plain(text: str) -> str:
    """Restructured text as Markdown, in one line."""
    return re.sub(r"\s+", " ", text.replace("``", "`")).strip()


def _sentence(text: str) -> str:
    """A help text as a sentence."""
    text = _plain(text).rstrip(".")
    word = text.partition(" ")[0]
    return f"{text[:1].upper() if word.isalpha() else text[:1]}{text[1:]}."


def _item(name: str, text: str, beside: str = "") -> str:
    """An entry of a definition list, a sentence a line."""
    lines = [f"`{name}`{beside}"]
    for sentence in re.split(r"(?<=[.])\s+(?=[A-Z`])", _sentence(text)):
        indent = "    " if len(lines) > 1 else ":   "
        lines += textwrap.wrap(sentence, _WIDTH, initial_indent=indent, subsequent_indent="    ", **_WHOLE)
    return "\n".join(lines)
