// Simple lines of an ISO program, read as `twin.nc.lines.scan` and written as `rewritten_lines` there do with arrays; they are
// compared in tests.
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>

namespace {

enum Kind : uint8_t { OTHER, LETTER, DIGIT, SIGN, POINT, BLANK, END };
constexpr int8_t NUMBER = -3, CODE = -2;
constexpr int WHOLE_DIGITS = 9, MOST_DIGITS = 15;
// Powers of ten that a double holds exactly.
constexpr double POWER[] = {1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15};

struct Line {
    int64_t begin, end;
};

// The end of the line that begins at a place: after LF, or after CR without LF.
int64_t line_end(const uint8_t* text, int64_t at, int64_t size) {
    for (; at < size; ++at) {
        if (text[at] == 10) return at + 1;
        if (text[at] == 13 && !(at + 1 < size && text[at + 1] == 10)) return at + 1;
    }
    return size;
}

}  // namespace

extern "C" {

struct Scanned {
    int64_t size;
    const uint8_t *text, *kind;
    const int8_t *rank, *axis;
    int64_t *start, *end;
    uint8_t *simple, *blank, *wide;
    int8_t* code;
    int64_t* first;
    int32_t* word_line;
    int8_t* word_axis;
    int32_t *word_start, *word_end;
    double* value;
    uint8_t* sign;
    int16_t *whole, *fraction;
    uint8_t *point, *padded;
    int64_t lines, words;
};

// A number as written, after its sign.
struct Number {
    int whole, fraction, points;
    int64_t digits;
};

// Read a number of digits and points; return where it ends.
static int64_t read_number(const uint8_t* text, int64_t at, Number& number) {
    int64_t digits = 0;
    int count = 0, whole = -1, points = 0;
    for (;; ++at) {
        const unsigned digit = text[at] - unsigned{'0'};
        if (digit < 10) {
            if (++count <= MOST_DIGITS) digits = 10 * digits + digit;
        } else if (text[at] == '.') {
            if (!points++) whole = count;
        } else {
            break;
        }
    }
    if (whole < 0) whole = count;
    number = {whole, count - whole, points, digits};
    return at;
}

// Read the lines; `blank` is 2 for a line that may be a comment. The text is followed by a zero, which is no character of a simple line.
void scan(Scanned* job) {
    const uint8_t* text = job->text;
    int64_t words = 0, line = 0;
    job->first[0] = 0;
    for (int64_t at = 0; at < job->size; ++line) {
        job->start[line] = at;
        job->code[line] = -1;
        job->wide[line] = 0;
        bool ordinary = true, good = true, any = false;
        const int64_t own = words;
        int8_t code = -1;
        int last_rank = -128;
        for (;;) {
            const uint8_t letter = text[at], kind = job->kind[letter];
            if (kind == BLANK) {
                ++at;
                continue;
            }
            ordinary = kind == LETTER || (kind == END && at < job->size);
            if (kind != LETTER) break;
            any = true;
            const int8_t axis = job->axis[letter], rank = job->rank[letter];
            good &= rank > last_rank;
            last_rank = rank;
            const int64_t begin = at + 1;
            const uint8_t sign = job->kind[text[begin]] == SIGN ? text[begin] : 0;
            Number number;
            const int64_t stop = read_number(text, begin + (sign != 0), number);
            const uint8_t after = job->kind[text[stop]];
            at = stop;
            ordinary = number.whole + number.fraction + number.points > 0 && (after == BLANK || after == LETTER || after == END);
            if (!ordinary) break;
            const int digits = number.whole + number.fraction;
            good &= number.points <= 1 && digits >= 1;
            if (axis == NUMBER || axis == CODE) good &= sign == 0 && number.points == 0;
            if (axis != NUMBER) good &= number.whole <= WHOLE_DIGITS && digits <= MOST_DIGITS;
            if (axis == CODE) {
                const int said = text[stop - 1] - '0';
                good &= said >= 0 && said <= 1 && (number.whole == 1 || (number.whole == 2 && text[begin] == '0'));
                code = static_cast<int8_t>(said);
                job->wide[line] = number.whole > 1;
            }
            if (axis >= 0 && good) {
                job->word_line[words] = static_cast<int32_t>(line);
                job->word_axis[words] = axis;
                job->word_start[words] = static_cast<int32_t>(begin);
                job->word_end[words] = static_cast<int32_t>(stop);
                const double size = static_cast<double>(number.digits) / POWER[number.fraction];
                job->value[words] = sign == '-' ? -size : size;
                job->sign[words] = sign;
                job->whole[words] = static_cast<int16_t>(number.whole);
                job->fraction[words] = static_cast<int16_t>(number.fraction);
                job->point[words] = number.points != 0;
                job->padded[words] = text[stop - 1] == '0';
                ++words;
            }
        }
        at = line_end(text, at, job->size);
        job->end[line] = at;
        job->blank[line] = ordinary ? !any : 2;
        good &= ordinary;
        if (!good) words = own;
        const bool simple = good && words > own;
        job->simple[line] = simple;
        if (simple) job->code[line] = code;
        if (!ordinary) job->wide[line] = 0;
        job->first[line + 1] = words;
    }
    job->lines = line;
    job->words = words;
}

struct Rewritten {
    int64_t begin, stop;  // range of the text to be written
    int64_t lines, axes;
    const uint8_t* text;
    const int64_t *line, *start, *end, *first;  // indices of the lines; ranges and first words of all lines
    const int8_t* word_axis;
    const int32_t *word_start, *word_end;
    const double* value;
    const uint8_t* sign;
    const int16_t *whole, *fraction;
    const uint8_t *point, *padded;
    const int64_t* count;    // segments of each line
    const double* targets;   // segments x axes
    const double* step;
    const int64_t *decimals, *scale;
    const uint8_t *letters, *own;
    double same_number;
    double* said;    // last values in the output, updated
    uint8_t* stale;  // updated
    int64_t style_point, style_min_decimals, style_leading_zero, style_plus, spaced, lower;  // updated
    uint8_t* out;
    int64_t written;
};

static uint8_t* number(uint8_t* out, int64_t steps, int64_t axis, const Rewritten* job) {
    uint64_t power = 1;
    for (int64_t i = 0; i < job->decimals[axis]; ++i) power *= 10;
    const uint64_t size = static_cast<uint64_t>(steps < 0 ? -steps : steps) * static_cast<uint64_t>(job->scale[axis]);
    const uint64_t whole = size / power;
    uint64_t fraction = size - whole * power;
    if (steps < 0) *out++ = '-';
    else if (job->style_plus) *out++ = '+';
    if (job->style_leading_zero || whole > 0 || fraction == 0) {
        uint8_t digits[20];
        int n = 0;
        uint64_t left = whole;
        do {
            digits[n++] = static_cast<uint8_t>('0' + left % 10);
            left /= 10;
        } while (left);
        while (n) *out++ = digits[--n];
    }
    int64_t wanted = job->style_min_decimals;
    uint8_t digits[40];
    int64_t shown = 0;
    for (int64_t i = job->decimals[axis] - 1; i >= 0; --i) {
        digits[i] = static_cast<uint8_t>('0' + fraction % 10);
        if (shown == 0 && digits[i] != '0') shown = i + 1;
        fraction /= 10;
    }
    if (shown > wanted) wanted = shown;
    if (wanted > 0 || job->style_point) *out++ = '.';
    for (int64_t i = 0; i < wanted; ++i) *out++ = i < job->decimals[axis] ? digits[i] : '0';
    return out;
}

// Take over the number format of a word in the text (`twin.nc.text.style_of`).
static void take_style(Rewritten* job, int64_t word) {
    const bool zero = job->value[word] == 0.0, tells = job->fraction[word] > 0;
    if (tells && job->padded[word]) {
        job->style_point = 0;
        job->style_min_decimals = job->fraction[word];
    } else if (!tells && (job->point[word] || !zero)) {
        job->style_point = job->point[word];
        job->style_min_decimals = 0;
    }
    if (tells && job->whole[word] == 1 && std::fabs(job->value[word]) < 1.0 && !zero) {
        job->style_leading_zero = 1;
    } else if (job->point[word] && job->whole[word] == 0) {
        job->style_leading_zero = 0;
    }
    if (job->sign[word] == '+') job->style_plus = 1;
    else if (job->sign[word] == 0) job->style_plus = 0;
}

// Write the lines with their new positions.
void rewrite(Rewritten* job) {
    constexpr int64_t UNKNOWN = std::numeric_limits<int64_t>::min();
    constexpr int64_t MOST_AXES = 64;
    const uint8_t* text = job->text;
    uint8_t* out = job->out;
    int64_t steps[MOST_AXES], before[MOST_AXES];
    bool known[MOST_AXES], touched[MOST_AXES] = {}, in_text[MOST_AXES];
    for (int64_t i = 0; i < job->axes; ++i) {
        known[i] = std::isfinite(job->targets[i]);
        before[i] = job->stale[i] || std::isnan(job->said[i]) ? UNKNOWN
                                                               : static_cast<int64_t>(std::nearbyint(job->said[i] / job->step[i]));
        steps[i] = 0;
    }
    int64_t at = job->begin;
    const double* target = job->targets;
    for (int64_t k = 0; k < job->lines; ++k) {
        const int64_t line = job->line[k], first = job->first[line], last = job->first[line + 1] - 1;
        const int64_t letter = job->word_start[first] - 1, end = job->end[line];
        bool headed = false;
        for (int64_t i = job->start[line]; i < letter; ++i) headed |= text[i] > ' ';
        const bool second = last > first;
        if (second || headed) {
            const int64_t place = (second ? job->word_start[first + 1] - 1 : letter) - 1;
            const uint8_t c = text[place > 0 ? place : 0];
            job->spaced = c == ' ' || c == '\t';
        }
        job->lower = text[letter] >= 'a';
        for (int64_t i = 0; i < job->axes; ++i) in_text[i] = false;
        for (int64_t segment = 0; segment < job->count[k]; ++segment, target += job->axes) {
            for (int64_t i = 0; i < job->axes; ++i) {
                if (known[i]) steps[i] = static_cast<int64_t>(std::nearbyint(target[i] / job->step[i]));
            }
            if (segment == 0) {
                for (int64_t word = first; word <= last; ++word) {
                    const int64_t axis = job->word_axis[word];
                    in_text[axis] = touched[axis] = true;
                    take_style(job, word);
                    const double value = job->value[word];
                    // Rounded as NumPy does, not fused into the subtraction.
                    const volatile double wanted = static_cast<double>(steps[axis]) * job->step[axis];
                    const bool same = std::fabs(value - wanted) < job->same_number &&
                                      !(value == 0.0 && job->sign[word] == '-') && !(job->sign[word] == 0 && job->style_plus);
                    const int64_t stop = same ? job->word_end[word] : job->word_start[word];
                    std::memcpy(out, text + at, stop - at);
                    out += stop - at;
                    at = job->word_end[word];
                    if (!same) out = number(out, steps[axis], axis, job);
                }
            }
            bool opened = false;
            for (int64_t i = 0; i < job->axes; ++i) {
                if (!known[i] || steps[i] == before[i] || (segment == 0 && in_text[i])) continue;
                if (job->spaced && (segment == 0 || opened)) *out++ = ' ';
                *out++ = static_cast<uint8_t>(job->lower ? job->letters[i] + 32 : job->own[i]);
                out = number(out, steps[i], i, job);
                touched[i] = opened = true;
            }
            if (segment == 0) {
                std::memcpy(out, text + at, end - at);
                out += end - at;
                at = end;
            } else if (opened) {
                if (text[end - 1] == 10 && end >= 2 && text[end - 2] == 13) *out++ = 13;
                *out++ = text[end - 1];
            }
            for (int64_t i = 0; i < job->axes; ++i) {
                if (known[i]) before[i] = steps[i];
            }
        }
    }
    std::memcpy(out, text + at, job->stop - at);
    out += job->stop - at;
    for (int64_t i = 0; i < job->axes; ++i) {
        if (!touched[i]) continue;
        job->said[i] = static_cast<double>(steps[i]) * job->step[i];
        job->stale[i] = 0;
    }
    job->written = out - job->out;
}
}
