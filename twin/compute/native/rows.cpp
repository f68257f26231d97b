// One routine over many rows. Before this file: simd.hpp, the sizes N inputs and O outputs, and the routine row.

struct Rows {
  int64_t rows;
  const double *const *in;   // N columns, and the distance of their rows (0: one number for all rows)
  const int64_t *in_step;
  double *const *out;        // O of them
  const int64_t *out_step;
  const double *k;
  double far;  // largest input
};

extern "C" int lanes() { return W; }

// Returns 1, and leaves the rest, if an input is larger.
extern "C" int64_t run(const Rows *given) {
  const Rows &job = *given;
  for (int64_t i = 0; i < job.rows; i += W) {
    V x[N], y[O];
    M far = M{};
    const int some = job.rows - i < W ? (int)(job.rows - i) : (int)W;
    for (int c = 0; c < N; ++c) {
      const double *in = job.in[c];
      const int64_t step = job.in_step[c];
      if (step == 1 && some == W) x[c] = loaded(in + i);
      else for (int l = 0; l < W; ++l) x[c][l] = in[(i + (l < some ? l : some - 1)) * step];  // the last row again to fill a register
    }
    for (int c = 0; c < N; ++c) far |= vabs(x[c]) > job.far;  // after all are filled: see `loaded`
    if (any(far)) return 1;
    row(x, job.k, y);
    for (int l = 0; l < some; ++l)
      for (int c = 0; c < O; ++c) job.out[c][(i + l) * job.out_step[c]] = ((const double *)&y[c])[l];
  }
  return 0;
}
