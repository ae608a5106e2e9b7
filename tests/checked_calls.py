"""Checks of shapes and types in part of the calls: of each function the first ones in every test, then ever fewer.

Checking every call doubles the time of the suite, nearly all of it in loops that call one function thousands of times
with the same shapes. `conftest.py` installs this before the package is imported.
"""

import functools
import inspect
from collections.abc import Callable
from typing import Any

import jaxtyping
from jaxtyping import _decorator as decorators

_EVERY_ONE = 4
"""First calls in a test that are checked; of later ones those whose number is a power of two."""

_check_every_call: Callable[..., Any] = decorators.jaxtyped


class _Test:
    number = 0


def begin_test() -> None:
    """Count the calls of all functions afresh."""
    _Test.number += 1


def install() -> None:
    """Let jaxtyping's import hook decorate with this in place of its own decorator."""
    decorators.jaxtyped = jaxtyping.jaxtyped = _checked


def _checked(*decorated: Any, **options: Any) -> Any:
    if len(decorated) != 1 or not inspect.isfunction(decorated[0]):  # classes, properties: their functions come here
        return _check_every_call(*decorated, **options)
    (function,) = decorated
    test = calls = 0

    @functools.cache
    def checking() -> Callable[..., Any]:
        """Made at the first call: for all functions of the package it takes seconds."""
        return _check_every_call(function, **options)

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        nonlocal test, calls
        __tracebackhide__ = True
        if test != _Test.number:
            test, calls = _Test.number, 0
        calls += 1
        is_checked = calls <= _EVERY_ONE or calls & (calls - 1) == 0
        return (checking() if is_checked else function)(*args, **kwargs)

    return call
