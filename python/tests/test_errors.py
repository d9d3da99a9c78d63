from __future__ import annotations

import pickle

import pytest

import gripcast as gc
from gripcast import _native


def test_panic_becomes_an_internal_error() -> None:
    with pytest.raises(gc.InternalError) as caught:
        _native._panic()  # type: ignore[attr-defined]
    assert "on purpose" in caught.value.what and caught.value.remedy


def test_error_says_what_where_and_how_to_fix_it() -> None:
    error = gc.InputError("the mesh is open", "cup.obj", "pass `wall_thickness_m`")
    assert str(error) == "cup.obj: the mesh is open\n  → pass `wall_thickness_m`"
    assert str(gc.Error("failed")) == "failed"
    assert isinstance(error, (gc.Error, ValueError))


def test_errors_pickle() -> None:
    error = pickle.loads(pickle.dumps(gc.NotFoundError("lost", "a", "b")))
    assert isinstance(error, gc.NotFoundError)
    assert (error.what, error.where, error.remedy) == ("lost", "a", "b")


def test_objects_cannot_be_changed() -> None:
    for thing, name in ((gc.Pose(), "t_m"), (gc.Placement(), "yaw_deg"), (gc.Object(gc.Mesh.builtin("box")), "mass_kg")):
        with pytest.raises(AttributeError):
            setattr(thing, name, 0.0)


def test_everything_public_has_a_docstring() -> None:
    for name in gc.__all__:
        if name == "__version__":
            continue
        thing = getattr(gc, name)
        assert thing.__doc__, name
        members = [member for member in vars(thing) if not member.startswith("_")] if isinstance(thing, type) else []
        fields = getattr(thing, "__dataclass_fields__", {})
        for member in members:
            if member not in fields:
                assert getattr(thing, member).__doc__, f"{name}.{member}"
        assert all(f"{member}" in str(thing.__doc__) for member in fields), name
