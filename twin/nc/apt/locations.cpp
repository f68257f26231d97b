// New locations of simple `GOTO` statements, written as `twin.nc.apt.dialect.written` does; they are compared in tests.
#include <cmath>
#include <cstdint>
#include <cstring>

namespace {

constexpr int VECTOR_DECIMALS = 9, LEAST_DECIMALS = 5, MOST_DECIMALS = 12;
constexpr uint64_t POWER[] = {1,         10,         100,         1000,         10000,         100000,       1000000,
                              10000000,  100000000,  1000000000,  10000000000,  100000000000,  1000000000000};
// Below this, a double plus one half is exact.
constexpr double LIMIT = 4503599627370496.0;

uint8_t* digits(uint8_t* out, uint64_t number, int width) {
    for (int i = width - 1; i >= 0; --i) {
        out[i] = static_cast<uint8_t>('0' + number % 10);
        number /= 10;
    }
    return out + width;
}

// Write a number with some decimals as Python's `%.*f` does, but zero without a sign; return null if it is too large for that.
uint8_t* fixed(uint8_t* out, double value, int decimals) {
    const double size = std::fabs(value), power = static_cast<double>(POWER[decimals]);
    const double scaled = size * power;
    if (!(scaled < LIMIT)) return nullptr;
    // Correctly rounded, ties to even: the sign of the fused sum is that of the exact one. `below` may be the whole number that
    // the product was rounded to; the sum is then negative.
    const double below = std::floor(scaled), over = std::fma(size, power, -(below + 0.5));
    uint64_t units = static_cast<uint64_t>(below);
    units += over > 0.0 || (over == 0.0 && (units & 1));
    if (value < 0.0 && units) *out++ = '-';
    const uint64_t whole = units / POWER[decimals];
    int width = 1;
    for (uint64_t left = whole / 10; left; left /= 10) ++width;
    out = digits(out, whole, width);
    *out++ = '.';
    return digits(out, units - whole * POWER[decimals], decimals);
}

// Write the components of a tool vector without trailing zeros; return null if one is too large.
uint8_t* vector_text(uint8_t* out, const double* vector) {
    for (int i = 0; i < 3; ++i) {
        if (i) *out++ = ',';
        out = fixed(out, vector[i], VECTOR_DECIMALS);
        if (!out) return nullptr;
        while (out[-1] == '0') --out;
        if (out[-1] == '.') --out;
    }
    return out;
}

uint8_t* copy(uint8_t* out, const uint8_t* from, int64_t size) {
    std::memcpy(out, from, static_cast<size_t>(size));
    return out + size;
}

}  // namespace

extern "C" {

struct Locations {
    int64_t begin, stop;  // range of the text to be written
    int64_t lines, axes;
    const uint8_t* text;
    const int64_t *line, *count;  // index of each line, and its number of segments
    const int64_t *start, *end, *first;  // ranges and first words of all lines
    const int32_t *word_start, *word_end;
    const int16_t* fraction;
    const double *positions, *vectors;  // segments x axes, segments x 3
    uint8_t* said;                      // the tool vector written last, updated
    int64_t said_size;                  // 0: unknown
    uint8_t* out;
    int64_t written;  // -1: a number is too large
};

void write_locations(Locations* job) {
    const uint8_t* text = job->text;
    const double *position = job->positions, *vector = job->vectors;
    uint8_t* out = job->out;
    int64_t at = job->begin;
    job->written = -1;
    for (int64_t k = 0; k < job->lines; ++k) {
        const int64_t line = job->line[k], first = job->first[line], last = job->first[line + 1] - 1;
        const int64_t start = job->start[line], end = job->end[line], begin = job->word_start[first];
        int64_t newline = end;
        if (newline > start && text[newline - 1] == '\n') --newline;
        if (newline > start && text[newline - 1] == '\r') --newline;
        bool again = last - first == 5;
        for (int64_t segment = 0; segment < job->count[k]; ++segment, position += job->axes, vector += 3) {
            out = segment ? copy(out, text + start, begin - start) : copy(out, text + at, begin - at);
            for (int i = 0; i < 3; ++i) {
                if (i) *out++ = ',';
                int decimals = job->fraction[first + i];
                if (decimals < LEAST_DECIMALS) decimals = LEAST_DECIMALS;
                if (decimals > MOST_DECIMALS) decimals = MOST_DECIMALS;
                out = fixed(out, position[i], decimals);
                if (!out) return;
            }
            uint8_t* stop = vector_text(out + 1, vector);
            if (!stop) return;
            const int64_t size = stop - (out + 1);
            const bool same = size == job->said_size && std::memcmp(out + 1, job->said, static_cast<size_t>(size)) == 0;
            if (!same) {
                std::memcpy(job->said, out + 1, static_cast<size_t>(size));
                job->said_size = size;
            }
            if (again || !same) {
                *out = ',';
                out = stop;
            }
            again = false;
            if (segment) {
                out = copy(out, text + newline, end - newline);
            } else {
                at = job->word_end[last];
                if (job->count[k] > 1) {
                    out = copy(out, text + at, end - at);
                    at = end;
                }
            }
        }
    }
    job->written = copy(out, text + at, job->stop - at) - job->out;
}
}
