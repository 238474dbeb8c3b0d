"""Lines and their checksums: what goes in comes out, and what has been changed is noticed."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from phoslab.instruments import wire

TEXT = st.text(
    st.characters(min_codepoint=0x20, max_codepoint=0x7E, exclude_characters="*"), min_size=1, max_size=180
)


def test_the_checksum_is_the_published_one() -> None:
    assert wire.crc16(b"123456789") == 0x29B1  # the catalogue's check value of CRC-16/CCITT-FALSE


@given(TEXT)
def test_a_line_comes_back_as_it_was(text: str) -> None:
    (line,) = wire.Lines().feed(wire.encode(text))
    assert wire.decode(line) == text


@given(TEXT, st.data())
def test_one_to_sixteen_wrong_bits_in_a_row_are_always_noticed(text: str, data: st.DataObject) -> None:
    """A burst no longer than the checksum is divisible by no such polynomial: Peterson and Brown, 1961."""
    line = bytearray(wire.encode(text)[:-1])
    body = 8 * (len(line) - 5)
    start = data.draw(st.integers(0, body - 1))
    burst = data.draw(st.integers(1, 0xFFFF))
    for i in range(16):
        if burst >> i & 1 and start + i < body:
            line[(start + i) // 8] ^= 0x80 >> (start + i) % 8
    if bytes(line) != wire.encode(text)[:-1]:
        assert wire.decode(bytes(line)) is None


@given(st.lists(TEXT, max_size=5), st.data())
def test_lines_do_not_depend_on_how_the_stream_is_cut(texts: list[str], data: st.DataObject) -> None:
    stream = b"".join(wire.encode(text) for text in texts)
    lines, found = wire.Lines(), []
    while stream:
        n = data.draw(st.integers(1, len(stream)))
        found += lines.feed(stream[:n])
        stream = stream[n:]
    assert [wire.decode(line) for line in found] == texts


@given(st.binary(max_size=600))
def test_noise_does_no_harm_and_the_next_line_is_heard(noise: bytes) -> None:
    lines = wire.Lines()
    for line in lines.feed(noise + b"\n"):
        wire.decode(line)
    assert [wire.decode(line) for line in lines.feed(wire.encode("1 PING 0"))] == ["1 PING 0"]


def test_a_line_without_end_takes_no_memory() -> None:
    lines = wire.Lines()
    for _ in range(100):
        assert lines.feed(b"X" * 1000) == []
    assert len(lines._rest) <= wire.LONGEST
    (tail,) = lines.feed(b"X" + wire.encode("1 PING 0"))
    assert wire.decode(tail) is None  # what is left of it is not taken for a line


@given(st.text(max_size=60))
def test_whatever_a_line_says_it_is_a_reply_an_event_or_nothing(text: str) -> None:
    assert isinstance(wire.parse(text), wire.Reply | wire.Event | None)
