// One routine over points on straight lines, reduced while it is evaluated. Before this file: simd.hpp, the sizes N inputs and
// O outputs, and the routine row. The last input is the fraction of a line. With one output, its largest value, at least 0, on each line; with more,
// totals of all but the last, which says by how much a point lies beyond what is known.

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

extern "C" int64_t along(Along *given) {
  Along &job = *given;
  const double inf = __builtin_inf();
  int64_t line = 0, point = 0;
  V squares[O] = {};
  double top[O];
  for (int c = 0; c < O; ++c) top[c] = -inf;
  job.count = 0;
  for (;;) {
    V x[N], y[O];
    int64_t at[W];
    int some = 0;
    while (some < W && line < job.lines) {
      if (point >= job.points[line]) { ++line; point = 0; continue; }
      at[some] = line;
      x[N - 1][some] = ((double)point + 0.5) / (double)job.points[line];
      ++point, ++some;
    }
    if (!some) break;
    for (int l = some; l < W; ++l) at[l] = at[some - 1], x[N - 1][l] = x[N - 1][some - 1];
    M far = M{};
    for (int c = 0; c < N - 1; ++c) {
      const double *in = job.in[c];
      const int64_t step = job.in_step[c];
      for (int l = 0; l < W; ++l) x[c][l] = in[at[l] * step];
      far |= vabs(x[c]) > job.far;
    }
    if (any(far)) return 1;
    row(x, job.k, y);
    if (O == 1) {
      for (int l = 0; l < some; ++l) {
        double &worst = job.worst[at[l]];
        if (worst == worst && !(y[0][l] <= worst)) worst = y[0][l];  // not-a-number stays
      }
      continue;
    }
    M keep = (y[0] < inf) & (y[O - 1] <= job.slack);
    for (int l = some; l < W; ++l) keep[l] = 0;
    for (int l = 0; l < some; ++l) job.count -= keep[l];
    for (int c = 0; c < O - 1; ++c) {
      squares[c] += where(keep, y[c] * y[c]);
      if (!any(keep & (y[c] > top[c]))) continue;
      for (int l = 0; l < some; ++l) {
        if (!keep[l] || !(y[c][l] > top[c])) continue;
        top[c] = y[c][l];
        job.line[c] = at[l];
        for (int o = 0; o < O - 1; ++o) job.largest[c * (O - 1) + o] = y[o][l];
      }
    }
  }
  for (int c = 0; c < O - 1; ++c) {
    job.squares[c] = 0.0;
    for (int l = 0; l < W; ++l) job.squares[c] += squares[c][l];
  }
  return 0;
}
