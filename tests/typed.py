"""The tests' type checker: jaxtyping's import hook with beartype, made light, and blind where granjax itself refuses.

`jaxtyping.jaxtyped`, which the hook puts on every function and class, is replaced before granjax is imported. Functions
without annotations stay as they are; of others arguments and result are checked; of an Equinox module its fields, once
it is made. Input that granjax refuses with its own ValueError may be of any type, since the refusal is what is tested.
"""

import contextlib
import dataclasses
import functools
import inspect
import typing

import beartype
import beartype.door
import equinox as eqx
import jaxtyping

jaxtyped = jaxtyping.jaxtyped


# a whole number is a real one too, as for static checkers
TOWER = beartype.BeartypeConf(is_pep484_tower=True)
checked = beartype.beartype(conf=TOWER)


def light(target=None, *, typechecker=None):
    """What stands for `jaxtyping.jaxtyped`."""
    if target is None:
        return functools.partial(light, typechecker=typechecker)
    if inspect.isclass(target):
        return _fields_checked(target)
    if not inspect.isfunction(target) or not target.__annotations__:
        return target
    # made at the first call: most of what is imported is never called by a worker
    strict = functools.cache(lambda: jaxtyped(target, typechecker=typechecker))

    @functools.wraps(target)
    def call(*args, **kwargs):
        try:
            return strict()(*args, **kwargs)
        except jaxtyping.TypeCheckError as error:
            if "checking the parameters" in str(error) and not hasattr(error, "seen"):
                error.seen = True
                target(*args, **kwargs)
            raise

    return call


def _fields_checked(cls):
    """The class, with the fields that it names itself checked when one is made."""
    if not issubclass(cls, eqx.Module):
        return cls
    own = vars(cls).get("__check_init__")
    hints = []

    def __check_init__(self):
        if not hints:
            hints.append(_hints(cls))
        with jaxtyped("context"):
            for name, hint in hints[0].items():
                value = getattr(self, name)
                if not beartype.door.is_bearable(value, hint, conf=TOWER):
                    raise jaxtyping.TypeCheckError(
                        f"{cls.__qualname__}.{name} is not {hint}: {value!r}"
                    )
        if own is not None:
            own(self)

    cls.__check_init__ = __check_init__
    return cls


def _hints(cls):
    """Annotations of a class's own fields; one that names what its module cannot import stays unchecked."""
    found = {}
    fields = {field.name for field in dataclasses.fields(cls)}
    for name, hint in vars(cls).get("__annotations__", {}).items():
        one = type("one", (), {"__annotations__": {name: hint}, "__module__": cls.__module__})
        if name in fields:
            with contextlib.suppress(NameError):
                found |= typing.get_type_hints(one, include_extras=True)
    return found


def install():
    """Before granjax is imported: once, for the whole process."""
    jaxtyping.jaxtyped = light
    jaxtyping.install_import_hook("granjax", "typed.checked")
