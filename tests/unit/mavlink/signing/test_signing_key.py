"""Key files: what is read, what is refused, what is made."""

import stat

import pytest

from bridge.mavlink.signing.key import load_key, make_key
from tests.unit.mavlink.signing.signing_helpers import SECRET


def test_made_key_is_private_random_and_never_written_over(tmp_path):
    one, two = tmp_path / "one", tmp_path / "two"
    make_key(one)
    make_key(two)
    assert stat.S_IMODE(one.stat().st_mode) == 0o600
    assert load_key(one).secret != load_key(two).secret
    assert load_key(one).secret.hex() not in repr(load_key(one))
    with pytest.raises(FileExistsError, match="not written over"):
        make_key(one)


@pytest.mark.parametrize("content", [SECRET, SECRET.hex().encode(), SECRET.hex().upper().encode() + b"\n"])
def test_key_file_holds_32_bytes_or_64_hexadecimal_characters(tmp_path, content):
    path = tmp_path / "key"
    path.touch(0o600)
    path.write_bytes(content)
    assert load_key(path).secret == SECRET


@pytest.mark.parametrize(
    "content", [b"", b"secret", SECRET[:-1], SECRET + b"\n", b"0" * 64, b"g" * 64, bytes(32)]
)
def test_other_content_is_no_key(tmp_path, content):
    path = tmp_path / "key"
    path.touch(0o600)
    path.write_bytes(content)
    with pytest.raises(ValueError, match="flightstack key FILE"):
        load_key(path)


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660, 0o644, 0o620])
def test_key_that_others_can_get_at_is_refused(tmp_path, mode):
    make_key(tmp_path / "key")
    (tmp_path / "key").chmod(mode)
    with pytest.raises(ValueError, match="chmod 600"):
        load_key(tmp_path / "key")


def test_missing_key_and_folder_are_clear_errors(tmp_path):
    with pytest.raises(OSError, match="flightstack key FILE"):
        load_key(tmp_path / "none")
    with pytest.raises(ValueError, match="no ordinary file"):
        load_key(tmp_path)
