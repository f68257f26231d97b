"""Simple lines written together: words replaced as `twin.nc.iso.writer.IsoWriter` does one by one.

The format of a word depends on the words before it (`twin.nc.text.style_of`): each sets some attributes of the style and keeps the
others. Each attribute at a word is therefore the last value set, which is computed for all words together.
"""

from __future__ import annotations

from typing import Final, final

import numpy as np

from twin.nc.emit import SAME_NUMBER, OutputState
from twin.nc.lines.scan import Scan, Words
from twin.nc.text import Style
from twin.nc.word_texts import Formatting, Grids, formatted_words

_UNKNOWN: Final = np.iinfo(np.int64).min
_MINUS, _PLUS, _SPACE = b"-+ "


def _with_replacements(
    text: np.ndarray, start: np.ndarray, end: np.ndarray, length: np.ndarray, new: np.ndarray
) -> bytes:
    """Return a text with some ranges replaced; they do not overlap, and insertions at one place are in order.

    Args:
        text: the text.
        start: (n,) beginnings of the ranges.
        end: (n,) their ends.
        length: (n,) length of each replacement.
        new: all replacements, concatenated.
    """
    order = np.argsort(start, kind="stable")
    start, end = start[order], end[order]
    content_at = (np.cumsum(length) - length + len(text))[order]
    begins, lengths = np.empty(2 * len(start) + 1, dtype=np.int64), np.empty(2 * len(start) + 1, dtype=np.int64)
    begins[0], begins[2::2], begins[1::2] = 0, end, content_at
    lengths[1::2] = length[order]
    lengths[0:-1:2] = start - begins[0:-1:2]
    lengths[-1] = len(text) - begins[-1]
    behind = np.cumsum(lengths)
    places = np.repeat((begins - behind + lengths).astype(np.int32), lengths)
    places += np.arange(len(places), dtype=np.int32)
    return np.concatenate([text, new])[places].tobytes()


def rewritten_lines(
    scan: Scan,
    whole: slice,
    lines: np.ndarray,
    count: np.ndarray,
    targets: np.ndarray,
    said: OutputState,
    formatting: Formatting,
    grids: Grids,
) -> tuple[bytes, Formatting]:
    """Return simple lines, consecutive except for blank ones, with new positions.

    Args:
        scan: the text.
        whole: the range of the text that contains the lines.
        lines: (lines,) indices of the lines.
        count: (lines,) number of segments of each line.
        targets: (segments, axes) end positions, mm and degrees; NaN in the columns of axes that are not written.
        said: last values in the output; updated.
        formatting: formatting before the first of the lines.
        grids: of the axes.

    Returns:
        The new text of the range, and the formatting after the last line.
    """
    segments = _Segments(scan, lines, count, targets, said, grids)
    of, words = segments.of_word, segments.words
    styles = _Styles(words, formatting.style)
    second = np.diff(scan.first)[lines] > 1
    first = segments.first_word
    letter = words.start[first] - 1
    before = scan.text[
        np.maximum(np.where(second, words.start[np.minimum(first + 1, len(words.start) - 1)] - 1, letter) - 1, 0)
    ]
    shown = second | segments.headed
    spaced = _forward_filled(np.where(shown, (before == _SPACE) | (before == 9), -1), formatting.spaced).astype(bool)
    lower = scan.text[letter] >= ord("a")
    # Words in the text whose value changes.
    steps = segments.steps.take(of * segments.steps.shape[1] + words.axis)
    same = np.abs(words.value - steps * grids.step[words.axis]) < SAME_NUMBER
    same &= ~((words.value == 0.0) & (words.sign == _MINUS)) & ~((words.sign == 0) & styles.plus)
    new = np.flatnonzero(~same)
    # Words that are missing in the text.
    row, axis = np.nonzero(segments.missing)
    line = segments.line[row]
    last_word = segments.last_word[line]
    extra = row != segments.head[line]
    opens = extra & np.append(True, row[1:] != row[:-1])[: len(row)]
    closes = extra & np.append(row[1:] != row[:-1], True)[-len(row) :] if len(row) else extra
    word = np.concatenate([new, last_word])
    letters = np.where(lower[line], grids.letters[axis] + 32, grids.own[axis]).astype(np.uint8)
    text, length = formatted_words(
        np.concatenate([steps[new], segments.steps[row, axis]]),
        np.concatenate([words.axis[new], axis]),
        styles.at(word),
        grids,
        np.concatenate([np.zeros(len(new), dtype=bool), spaced[line] & ~opens]),
        np.concatenate([np.zeros(len(new), dtype=np.uint8), letters]),
        np.concatenate(
            [np.zeros((len(new), 2), dtype=np.uint8), np.where(closes[:, None], _ending(scan, lines)[line], 0)]
        ),
    )
    behind = np.where(extra, scan.end[lines][line], words.end[last_word])
    start, end = np.concatenate([words.start[new], behind]), np.concatenate([words.end[new], behind])
    written = _with_replacements(scan.text[whole], start - whole.start, end - whole.start, length, text)
    for i in range(len(grids.step)):
        if np.any(words.axis == i) or np.any(axis == i):
            said.value[i] = float(segments.steps[-1, i] * grids.step[i])
            said.stale[i] = False
    return written, Formatting(styles.last(), bool(spaced[-1]), bool(lower[-1]))


@final
class _Segments:
    """The segments of some lines, and which words they need in addition to those in the text."""

    def __init__(
        self, scan: Scan, lines: np.ndarray, count: np.ndarray, targets: np.ndarray, said: OutputState, grids: Grids
    ) -> None:
        begin, end = scan.first[lines[0]], scan.first[lines[-1] + 1]
        all_words = scan.words
        self.words = Words(**{name: getattr(all_words, name)[begin:end] for name in Words.__dataclass_fields__})
        self.first_word = scan.first[lines] - begin
        self.last_word = scan.first[lines + 1] - begin - 1
        self.head = np.cumsum(count) - count
        self.line = np.repeat(np.arange(len(lines)), count)
        self.of_word = np.repeat(self.head, self.last_word - self.first_word + 1)
        known = np.isfinite(targets[0])
        with np.errstate(invalid="ignore"):
            self.steps = np.where(known, np.rint(targets / grids.step), 0.0).astype(np.int64)
        begins = [
            _UNKNOWN if said.stale[i] or value != value else int(np.rint(value / grids.step[i]))
            for i, value in enumerate(said.value)
        ]
        self.missing = np.empty(self.steps.shape, dtype=bool)
        self.missing[0] = self.steps[0] != begins
        np.not_equal(self.steps[1:], self.steps[:-1], out=self.missing[1:])
        self.missing &= known
        self.missing[self.of_word, self.words.axis] = False
        # Whether any word stands before the first axis word.
        letter = self.words.start[self.first_word] - 1
        start = scan.start[lines]
        self.headed = np.zeros(len(lines), dtype=bool)
        at = start.copy()
        for _ in range(int((letter - start).max(initial=0))):
            within = at < letter
            self.headed |= within & (scan.text[at] > _SPACE)
            at += within
            if np.all(self.headed | (at >= letter)):
                break


@final
class _Styles:
    """The style in force after every word (`twin.nc.text.style_of`)."""

    def __init__(self, words: Words, style: Style) -> None:
        zero = words.value == 0.0
        tells = words.fraction > 0
        round_ = ~tells & (words.point | ~zero)
        point = np.where(round_, words.point, -1)
        min_decimals = np.where(round_, 0, -1)
        padded = tells & words.padded
        point[padded], min_decimals[padded] = 0, words.fraction[padded]
        leading_zero = np.where(words.point & (words.whole == 0), 0, -1)
        leading_zero[tells & (words.whole == 1) & (np.abs(words.value) < 1.0) & ~zero] = 1
        plus = np.where(words.sign == _PLUS, 1, np.where(words.sign == _MINUS, -1, 0))
        self.point = _forward_filled(point, style.point)
        self.min_decimals = _forward_filled(min_decimals, style.min_decimals)
        self.leading_zero = _forward_filled(leading_zero, style.leading_zero)
        self.plus = _forward_filled(plus, style.plus).astype(bool)

    def at(self, word: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return point, minimum decimals, leading zero and plus after some words."""
        return (
            self.point[word].astype(bool),
            self.min_decimals[word],
            self.leading_zero[word].astype(bool),
            self.plus[word],
        )

    def last(self) -> Style:
        """Return the style after the last word."""
        return Style(
            bool(self.point[-1]), int(self.min_decimals[-1]), bool(self.leading_zero[-1]), bool(self.plus[-1]), False
        )


def _forward_filled(values: np.ndarray, before: int) -> np.ndarray:
    """Return (n,) each value, or the last one before it that is not -1."""
    says = values >= 0
    if says.all():
        return values
    if not says.any():
        return np.full(len(values), before)
    at = np.flatnonzero(says)
    return np.repeat(np.append(before, values[at]), np.diff(at, prepend=0, append=len(values)))


def _ending(scan: Scan, lines: np.ndarray) -> np.ndarray:
    """Return (lines, 2) the characters that end each line, 0 for none."""
    end = scan.end[lines]
    two = (scan.text[end - 1] == 10) & (scan.text[np.maximum(end - 2, 0)] == 13)
    return np.stack([np.where(two, 13, 0), scan.text[end - 1]], axis=1).astype(np.uint8)
