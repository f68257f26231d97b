// One routine over points on straight lines, reduced while it is evaluated. Before this file: simd.hpp, the sizes N inputs and
// O outputs, and the routine row. The last input is the fraction of a line. With one output, its largest value, at least 0, on each line; with more,
// totals of all but the last, which says by how much a point lies beyond what is known.
//
// A register holds one point of each of W lines, so that the inputs of a line are fetched once; where lines have different numbers of
// points, it holds the further points of one line.

struct Along {
  int64_t lines;
  const double *const *in;   // N - 1 columns, and the distance of their rows (0: one number for all lines)
  const int64_t *in_step;
  const int64_t *points;     // of each line, evenly spread
  const double *k;
  double far, slack;         // largest input; largest value of the last output
  double *worst;             // one output: of each line
  int64_t count;             // more: number of known points; sums of squares; for each output all outputs where it is largest, and the line
  double *squares, *largest;
  int64_t *line;
};

static __attribute__((noinline)) void run_row(const V *x, const double *k, V *y) { row(x, k, y); }

struct Totals {
  V squares[O];
  double top[O];
  M count;
};

// Add the points in `keep` of the lines `at`.
INLINE void add(Along &job, Totals &totals, const V *y, M keep, const int64_t *at) {
  keep &= (y[0] < __builtin_inf()) & (y[O - 1] <= job.slack);
  totals.count += keep;
  M larger = M{};
  for (int c = 0; c < O - 1; ++c) {
    totals.squares[c] += where(keep, y[c] * y[c]);
    larger |= y[c] > totals.top[c];
  }
  larger &= keep;
  if (!any(larger)) return;
  for (int l = 0; l < W; ++l) {
    if (!larger[l]) continue;
    for (int c = 0; c < O - 1; ++c) {
      if (!(y[c][l] > totals.top[c])) continue;
      totals.top[c] = y[c][l];
      job.line[c] = at[l];
      for (int o = 0; o < O - 1; ++o) job.largest[c * (O - 1) + o] = y[o][l];
    }
  }
}

// The largest value of each lane; not-a-number stays.
INLINE V worse(V worst, V y, M there) { return there & ~(y <= worst) & (worst == worst) ? y : worst; }

extern "C" int64_t along(Along *given) {
  Along &job = *given;
  Totals totals = {};
  for (int c = 0; c < O; ++c) totals.top[c] = -__builtin_inf();
  V number, y[O];
  for (int l = 0; l < W; ++l) number[l] = l;
  for (int64_t line = 0; line < job.lines; line += W) {
    const int some = job.lines - line < W ? (int)(job.lines - line) : (int)W;
    V x[N], points;
    M far = M{};
    int64_t at[W], least = job.points[line], most = least;
    for (int l = 0; l < W; ++l) {
      at[l] = line + (l < some ? l : some - 1);
      const int64_t n = job.points[at[l]];
      points[l] = (double)n;
      least = n < least ? n : least;
      most = n > most ? n : most;
    }
    for (int c = 0; c < N - 1; ++c) {
      const double *in = job.in[c];
      const int64_t step = job.in_step[c];
      if (step == 1 && some == W) x[c] = loaded(in + line);
      else for (int l = 0; l < W; ++l) x[c][l] = in[at[l] * step];
    }
    for (int c = 0; c < N - 1; ++c) far |= vabs(x[c]) > job.far;  // after all are filled: see `loaded`
    if (any(far)) return 1;
    const M there = number < (double)some;
    V worst = V{};
    for (int64_t k = 0; k < least; ++k) {
      x[N - 1] = ((double)k + 0.5) / points;
      run_row(x, job.k, y);
      if (O == 1) worst = worse(worst, y[0], there);
      else add(job, totals, y, there, at);
    }
    for (int l = 0; most > least && l < some; ++l) {
      V own[N], own_worst = all(worst[l]);
      int64_t same[W];
      for (int i = 0; i < W; ++i) same[i] = at[l];
      for (int c = 0; c < N - 1; ++c) own[c] = all(x[c][l]);
      for (int64_t k = least; k < job.points[at[l]]; k += W) {
        const V place = number + (double)k;
        const M inside = place < points[l];
        own[N - 1] = (place + 0.5) / points[l];
        run_row(own, job.k, y);
        if (O == 1) own_worst = worse(own_worst, y[0], inside);
        else add(job, totals, y, inside, same);
      }
      for (int i = 0; O == 1 && i < W; ++i)
        if (worst[l] == worst[l] && !(own_worst[i] <= worst[l])) worst[l] = own_worst[i];
    }
    for (int l = 0; O == 1 && l < some; ++l) job.worst[line + l] = worst[l];
  }
  if (O == 1) return 0;
  job.count = 0;
  for (int l = 0; l < W; ++l) job.count -= totals.count[l];
  for (int c = 0; c < O - 1; ++c) {
    job.squares[c] = 0.0;
    for (int l = 0; l < W; ++l) job.squares[c] += totals.squares[c][l];
  }
  return 0;
}
