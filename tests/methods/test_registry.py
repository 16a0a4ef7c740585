"""Names of methods: each is of one thing, of whatever kind."""

import pytest

from eitbench.commands.scaffold import _check_name
from eitbench.methods import Method, register, register_operator, register_place_method
from eitbench.methods.operator import Operator
from eitbench.methods.place_method import PlaceMethod
from eitbench.methods.registry import METHOD_REGISTRY
from eitbench.scenarios.errors import InputError


class _Method(Method):
    pass


class _Operator(Operator):
    pass


class _PlaceMethod(PlaceMethod):
    pass


class _Talking:
    """An installed plugin that prints as it is imported."""

    value = "talking:Talking"
    name = "talking"

    def load(self) -> object:
        print("hello from the plugin")
        return None


def test_what_an_installed_plugin_prints_is_kept_out_of_what_programs_read(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("eitbench.methods.registry.installed", lambda group: [_Talking()])
    METHOD_REGISTRY.known()
    said = capsys.readouterr()
    assert (said.out, said.err) == ("", "hello from the plugin\n")


@pytest.mark.parametrize(
    ("decorate", "cls", "name", "kind"),
    [
        (register, _Method, "kernel-ridge", "place method"),
        (register, _Method, "fem", "operator"),
        (register_operator, _Operator, "noser", "method"),
        (register_place_method, _PlaceMethod, "noser", "method"),
    ],
)
def test_a_name_of_another_kind_is_taken(decorate: object, cls: type, name: str, kind: str) -> None:
    """A run would have used the one, and named the file of the other."""
    assert callable(decorate)
    with pytest.raises(InputError, match=rf"The name '{name}' is taken by eitbench\..* \({kind}\)"):
        decorate(name)(cls)
    with pytest.raises(InputError, match=rf"The name '{name}' is taken \({kind}\)"):
        _check_name(name)
