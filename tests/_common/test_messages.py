"""Tests of messages: English as text, translated with a catalogue, never damaged."""

from __future__ import annotations

import copy
import json
import pickle
from html import escape, unescape

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from twin._common.messages import (
    Message,
    Number,
    Quoted,
    Translation,
    joined,
    message_data,
    message_from,
    say,
    say_html,
    translated,
)
from twin.display import Html, expanded, figure, with_half
from twin.display.markup import templates
from twin.display.numbers import capital, listed, lower

CATALOGUE = {
    "unknown": "unbekannt",
    "at least": "mindestens",
    "{value} (± unknown)": "{value} (± unbekannt)",
    "backlash of {axis}": "Umkehrspanne {axis}",
    "the readings of {axis}": "die Messwerte von {axis}",
    "{names} and {last}": "{names} und {last}",
    "{names} and {count} more": "{names} und {count} weitere",
    "{count:,} points, {share:.1f} %": "{share:.1f} % von {count:,} Punkten",
    "a < {b}": "a < {b}",
}
SPACE = "\N{NARROW NO-BREAK SPACE}"


@pytest.mark.parametrize(
    ("message", "german"),
    [
        (Message("{count:,} points, {share:.1f} %", count=1234, share=2.5), f"2,5 % von 1{SPACE}234 Punkten"),
        (expanded(1.5, complete=False), "mindestens 1,50 µm"),
        (with_half(60.0, float("nan"), "urad"), "60,0 µrad (± unbekannt)"),
        (figure(float("nan"), "µm"), "unbekannt"),
        (listed([f"E_{i}" for i in range(10)]), "E_0, E_1, E_2, E_3, E_4, E_5, E_6 und 3 weitere"),
        (listed([Message("backlash of {axis}", axis="X"), "a 1.5.csv"]), "Umkehrspanne X und a 1.5.csv"),
        (capital(Message("the readings of {axis}", axis="X")), "Die Messwerte von X"),
        (lower(Message("backlash of {axis}", axis="X")), "Umkehrspanne X"),
        (joined(": ", ["E_XX", Quoted("seed 3.5, with noise")]), "E_XX: seed 3.5, with noise"),
    ],
)
def test_translated(message: Message, german: str) -> None:
    """Numbers get a decimal comma, names and files stay as they are, nouns keep their capitals."""
    with translated(Translation(CATALOGUE)):
        assert say(message) == german
    assert say(message) is message


def test_what_has_no_translation_is_marked_and_counted() -> None:
    """Only the part without translation is marked; the same text counts once."""
    translation = Translation(CATALOGUE)
    message = joined("; ", [Message("a < {b}", b=Quoted("c & d")), Message("a <new> message"), "e > f"])
    with translated(translation):
        expected = "a &lt; <span lang=en>c &amp; d</span>; <span lang=en>a &lt;new&gt; message</span>; e &gt; f"
        assert say_html(message) == expected
        assert templates().from_string("<p>{{ one }}{{ safe }}</p>").render(one=message, safe=Html("<b>")) == (
            f"<p>{expected}<b></p>"
        )
        assert say(message) == "a < c & d; a <new> message; e > f"
    assert list(translation.missing) == ["c & d", "a <new> message"]
    assert templates().from_string("{{ one }}").render(one=message) == escape(message)


def test_a_message_is_text() -> None:
    message = capital(Message("{count:,} points, {share:.1f} %", count=1234, share=2.5))
    assert json.dumps([message]) == '["1,234 points, 2.5 %"]' and message == "1,234 points, 2.5 %"
    for again in (pickle.loads(pickle.dumps(message)), copy.deepcopy(message)):
        assert again == message and vars(again) == vars(message)


@given(st.text(max_size=60))
def test_any_text_survives(text: str) -> None:
    """Text from a file, with braces or tags, is never damaged."""
    with translated(Translation(CATALOGUE)):
        for value in (Quoted(text), Message("{text}", text=text), joined("", [text, Number("")])):
            assert say(value) == text
            shown = say_html(value).removeprefix("<span lang=en>").removesuffix("</span>")
            assert unescape(shown) == unescape(escape(text)) and "<" not in shown


def test_a_message_is_kept_in_a_file() -> None:
    """The data are plain, as YAML can hold them, and give the same message in every language."""
    names = joined(", ", [Message("station {name}", name="1"), "target K"])
    message = Message(
        "cannot be separated from {names}", names=Message("{names} and {count} more", names=names, count=3)
    )
    data = yaml.safe_load(yaml.safe_dump(message_data(message)))
    read = message_from(data)
    assert isinstance(read, Message) and read == message == "cannot be separated from station 1, target K and 3 more"
    german = Translation(
        {
            "cannot be separated from {names}": "nicht zu trennen von {names}",
            "{names} and {count} more": "{names} und {count} weitere",
            "station {name}": "Standpunkt {name}",
        }
    )
    assert german.text(read) == "nicht zu trennen von Standpunkt 1, target K und 3 weitere"
    assert message_from("plain") == "plain" and message_data("plain") == "plain"


@pytest.mark.parametrize(
    "data",
    [
        "",
        None,
        3,
        [],
        {},
        {"text": "a {b}"},
        {"text": "a", "b": "c"},
        {"text": "{b.c}", "b": "d"},
        {"text": "{0}", "0": "d"},
    ],
)
def test_what_is_no_message_is_refused(data: object) -> None:
    with pytest.raises(ValueError, match=r"expected text|in braces"):
        message_from(data)


def test_few_digits_without_exponent() -> None:
    """As `%g` counts digits, but as a person writes them; very large and very small numbers keep their exponent."""
    message = Message("{left:.3g} µm, {share:.2g} %", left=1010.4, share=99.7)
    assert message == "1010 µm, 100 %"
    with translated(Translation({message.identifier: "{share:.2g} % von {left:.3g} µm"})):
        assert say(message) == "100 % von 1010 µm"
    assert Message("{a:.2g} {b:.3g} {c:.3g}", a=-1234567, b=1.5e12, c=1e-6) == "-1200000 1.5e+12 1e-06"
