"""YAML that a user may have written: plain values alone, of bounded depth and size, every mistake one line."""

from typing import Any

import yaml

from torchhand.errors import InputError

_MAX_DEPTH = 32
_MAX_NODES = 20_000  # with everything that aliases repeat


class _Loader(yaml.SafeLoader):
    """Safe YAML that refuses a key given twice, nesting without end, and aliases that multiply."""

    def __init__(self, stream: str) -> None:
        super().__init__(stream)
        self._depth = self._nodes = 0
        self._sizes: dict[int, int] = {}

    def compose_node(self, parent: Any, index: Any) -> Any:
        mark = self.peek_event().start_mark
        is_alias = self.check_event(yaml.AliasEvent)
        before = self._nodes
        self._nodes, self._depth = self._nodes + 1, self._depth + 1
        if self._depth > _MAX_DEPTH:
            raise yaml.constructor.ConstructorError(None, None, f"more than {_MAX_DEPTH} levels", mark)
        node = super().compose_node(parent, index)
        if is_alias and id(node) not in self._sizes:
            raise yaml.constructor.ConstructorError(None, None, "an alias that stands within itself", mark)
        self._nodes += self._sizes.get(id(node), 0) if is_alias else 0
        if self._nodes > _MAX_NODES:
            raise yaml.constructor.ConstructorError(None, None, f"more than {_MAX_NODES} values", mark)
        self._depth -= 1
        self._sizes.setdefault(id(node), self._nodes - before)
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[str] = set()
        for key_node, _ in node.value:
            key = str(getattr(key_node, "value", ""))
            if key in seen:
                raise yaml.constructor.ConstructorError(None, None, f"key {key!r} is given twice", key_node.start_mark)
            seen.add(key)
        return super().construct_mapping(node, deep)


def read_yaml(text: str, where: str) -> Any:
    """The value of a YAML text; `where` names it for the error. Raises InputError with the line where it is known."""
    try:
        return yaml.load(text, Loader=_Loader)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f", line {mark.line + 1}" if mark else ""
        reason = " ".join(str(getattr(error, "problem", None) or error).split())
        raise InputError(f"{where}{line}: is no valid YAML ({reason})") from error
    except (ValueError, OverflowError, RecursionError) as error:  # dates and numbers that there are not
        raise InputError(f"{where}: is no valid YAML ({error})") from error
