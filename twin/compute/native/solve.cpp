// Newton's method on blocks of poses. Before this file: simd.hpp, the sizes
//   A axes, N inputs of a routine, R rotary axes and ROTARY[], S sides, K numbers in the matrices of a step,
// and the routines turn, again, follow, repair, check (StepFunctions in problem.py).
// The algorithm is that of `NumpySolver` (solver.py), pose by pose; tests compare the two.

struct Job {
  int64_t rows;
  const double *start, *point, *axis, *approach;
  const uint8_t *loose;  // whether the rotary axes may move
  int64_t start_row, start_column, point_row, point_column, axis_row, axis_column, approach_row, approach_column, loose_row;
  double *positions, *distance, *axis_angle_rad;
  uint8_t *code;
  const double *k_turn, *k_again, *k_follow, *k_repair, *k_check;
  const double *scale, *lower, *upper;   // mm and degrees: range and domain of the curves
  const double *first, *last;            // rotary axes, radians
  double rotary_limit, tolerance, near, largest, mm;
  int64_t steps, taken;
};

enum { CONVERGED = 0, OUT_OF_RANGE = 1, SINGULAR = 2, FOR_NUMPY = 3 };
enum { BLOCK = 1024, SOON = 3, COLUMNS = N };
enum { LINE = BLOCK + W };  // column stride: not a multiple of a page, or all columns would share one cache line

struct Block {
  V in[COLUMNS][LINE / W];  // inputs of a routine, one column each
  V out[A + 2][LINE / W];
  uint8_t code[BLOCK];
};

#define NOINLINE static __attribute__((noinline))

NOINLINE void run_turn(const V *x, const double *k, V *y) { turn(x, k, y); }
NOINLINE void run_again(const V *x, const double *k, V *y) { again(x, k, y); }
NOINLINE void run_follow(const V *x, const double *k, V *y) { follow(x, k, y); }
NOINLINE void run_repair(const V *x, const double *k, V *y) { repair(x, k, y); }
NOINLINE void run_check(const V *x, const double *k, V *y) { check(x, k, y); }

struct Found { M done; V check[9]; int64_t steps; };

template <bool rotary>
NOINLINE Found newton(const Job &job, V *x, M active, int64_t limit) {
  Found found;
  found.done = M{};
  const double inf = __builtin_inf();
  V last = all(inf);
  bool checked = false;
  int64_t s = 0;
  V y[A + 1 + K];
  for (;; ++s) {
    // From the third evaluation on most have converged; the residual alone costs half as much as a step.
    if (s >= 2) {
      run_check(x, job.k_check, found.check);
      checked = true;
      V size = found.check[rotary ? 0 : 1];
      M finished = (size <= 0.1 * job.tolerance) | ((size <= job.tolerance) & (size >= last));
      if (!any(active & ~finished & (size < inf))) {
        found.done |= active & finished;
        break;
      }
      if (rotary && s == 2) {  // the residual is so small that the last matrices can be reused
        found.done |= active & finished;
        active = active & ~finished & (size < inf);
        last = size;
        const M far = active & (size > job.near);
        V left[5 + K], move[A];
        for (int c = 0; c < 5; ++c) left[c] = found.check[4 + c];
        for (int c = 0; c < K; ++c) left[5 + c] = y[A + 1 + c];
        run_again(left, job.k_again, move);
        if (any(far)) run_turn(x, job.k_turn, y);
        for (int a = 0; a < A; ++a) x[a] = active ? (far ? y[a] : x[a] + move[a]) : x[a];
        checked = false;
        continue;
      }
    }
    if (rotary) run_turn(x, job.k_turn, y); else run_follow(x, job.k_follow, y);
    V size = y[A];
    M finished = (size <= 0.1 * job.tolerance) | ((size <= job.tolerance) & (size >= last));
    found.done |= active & finished;
    active = active & ~finished & (size < inf);
    last = size;
    if (s == limit || !any(active)) break;
    for (int a = 0; a < A; ++a) x[a] = active ? y[a] : x[a];
    checked = false;
  }
  found.steps = s;
  if (!checked) run_check(x, job.k_check, found.check);
  return found;
}

INLINE void lane_in(Block &b, const int *rows, int count, V *x) {
  for (int c = 0; c < COLUMNS; ++c) {
    const double *column = (const double *)b.in[c];
    for (int l = 0; l < W; ++l) x[c][l] = column[rows[l < count ? l : count - 1]];
  }
}

// Results of the lanes in `which`: positions, remaining distances, and the code.
NOINLINE void store(const Job &job, Block &b, const int *rows, M which, const V *x, const V *left, uint8_t reached) {
  V result[A + 2];
  M beyond = M{};
  for (int a = 0; a < A; ++a) {
    result[a] = x[a] / job.scale[a];
    beyond |= (result[a] < job.lower[a]) | (result[a] > job.upper[a]);
  }
  V distance = vsqrt(left[2]);
  M missed = ~(distance <= 2.0 * job.tolerance) | beyond;
  result[A] = distance / job.mm;
  V d = vsqrt(left[3]), dd = d * d;
  // 2 asin(d/2) where its series is exact; the caller computes the others.
  V angle = d + d * dd * (1.0 / 24 + dd * (3.0 / 640));
  result[A + 1] = d < 0.01 ? angle : d;
  bool beside = !any(~which | missed);
  for (int l = 1; l < W && beside; ++l) beside = rows[l] == rows[0] + l;
  if (beside) {
    for (int c = 0; c < A + 2; ++c) __builtin_memcpy((double *)b.out[c] + rows[0], &result[c], sizeof(V));
    __builtin_memset(b.code + rows[0], reached, W);
    return;
  }
  for (int l = 0; l < W; ++l) {
    if (!which[l]) continue;
    for (int c = 0; c < A + 2; ++c) ((double *)b.out[c])[rows[l]] = result[c][l];
    b.code[rows[l]] = missed[l] ? OUT_OF_RANGE : reached;
  }
}

INLINE M admissible(const Job &job, const V *x, const V *start) {
  M inside = M{} - 1;
  for (int r = 0; r < R; ++r) {
    V q = x[ROTARY[r]];
    inside &= (q >= job.first[r]) & (q <= job.last[r]) & (vabs(q - start[ROTARY[r]]) <= job.rotary_limit);
  }
  return inside;
}

// Rows of the caller's arrays into columns of a block, row by row: each row is fetched once.
NOINLINE void load(const Job &job, int64_t from, int count, Block &b) {
  double *in = (double *)b.in;
  const double *start = job.start + from * job.start_row, *point = job.point + from * job.point_row;
  const double *axis = job.axis + from * job.axis_row, *approach = job.approach + from * job.approach_row;
  for (int i = 0; i < count; ++i) {
    for (int a = 0; a < A; ++a) in[a * LINE + i] = start[i * job.start_row + a * job.start_column] * job.scale[a];
    for (int s = 0; s < S; ++s) in[(A + s) * LINE + i] = approach[i * job.approach_row + s * job.approach_column];
    for (int c = 0; c < 3; ++c) {
      in[(N - 6 + c) * LINE + i] = point[i * job.point_row + c * job.point_column] * job.mm;
      in[(N - 3 + c) * LINE + i] = axis[i * job.axis_row + c * job.axis_column];
    }
  }
  for (int c = 0; c < COLUMNS; ++c)  // the padding of the last register is not a pose
    for (int i = count; i < (count + W - 1) / W * W; ++i) in[c * LINE + i] = __builtin_nan("");
}

// Whether all values of a register are finite and not too large.
INLINE M sound(const Job &job, Block &b, int g, M &small) {
  const double inf = __builtin_inf();
  V square = V{};
  for (int c = N - 3; c < N; ++c) square += b.in[c][g] * b.in[c][g];
  const V unit = 1.0 / vsqrt(square);
  M good = M{} - 1;
  small = M{} - 1;
  for (int c = N - 3; c < N; ++c) b.in[c][g] *= unit;
  for (int c = 0; c < COLUMNS; ++c) {
    if (c < A || c >= A + S) good &= vabs(b.in[c][g]) < inf;
    if (c < A) small &= vabs(b.in[c][g]) <= job.largest;
  }
  return good;
}

extern "C" int lanes() { return W; }

extern "C" void solve(Job *given) {
  Job &job = *given;
  static_assert(BLOCK % W == 0, "whole registers");
  Block b;
  const double inf = __builtin_inf();
  int pending[BLOCK], stuck[BLOCK], held[BLOCK];
  job.taken = 0;
  for (int64_t from = 0; from < job.rows; from += BLOCK) {
    const int count = job.rows - from < BLOCK ? (int)(job.rows - from) : (int)BLOCK;
    load(job, from, count, b);
    int pendings = 0, stucks = 0, helds = 0;
    for (int g = 0; g * W < count; ++g) {
      V x[COLUMNS], start[A];
      M small, good = sound(job, b, g, small), on = M{} - 1;
      int rows[W];
      for (int l = 0; l < W; ++l) rows[l] = g * W + l;
      const bool whole = (g + 1) * W <= count && !any(~(good & small));
      for (int l = 0; l < W; ++l) {
        const int i = rows[l];
        if (whole && R != 0 && job.loose[(from + i) * job.loose_row]) continue;
        on[l] = 0;
        if (i >= count) continue;
        if (!good[l]) {
          for (int a = 0; a < A; ++a) ((double *)b.out[a])[i] = __builtin_nan("");
          ((double *)b.out[A])[i] = ((double *)b.out[A + 1])[i] = inf;
          b.code[i] = OUT_OF_RANGE;
        } else if (!small[l]) {
          b.code[i] = FOR_NUMPY;
        } else if (R == 0 || !job.loose[(from + i) * job.loose_row]) {
          held[helds++] = i;
        } else {
          on[l] = -1;
        }
      }
      if (!any(on)) continue;
      for (int c = 0; c < COLUMNS; ++c) x[c] = b.in[c][g];
      for (int a = 0; a < A; ++a) start[a] = x[a];
      Found found = newton<true>(job, x, on, SOON);
      M reached = found.done & admissible(job, x, start);
      store(job, b, rows, on & reached, x, found.check, CONVERGED);
      if (!any(on & ~reached)) {
        if (found.steps > job.taken) job.taken = found.steps;
        continue;
      }
      for (int l = 0; l < W; ++l)
        if (on[l] && !reached[l]) (found.done[l] ? stuck[stucks++] : pending[pendings++]) = rows[l];
    }
    for (int i = 0; i < pendings; i += W) {
      V x[COLUMNS], start[A];
      const int some = pendings - i < W ? pendings - i : (int)W;
      lane_in(b, pending + i, some, x);
      M on = M{};
      for (int l = 0; l < some; ++l) on[l] = -1;
      for (int a = 0; a < A; ++a) start[a] = x[a];
      Found found = newton<true>(job, x, on, job.steps);
      M reached = on & found.done & admissible(job, x, start);
      store(job, b, pending + i, reached, x, found.check, CONVERGED);
      if (found.steps > job.taken) job.taken = found.steps;
      for (int l = 0; l < some; ++l)
        if (!reached[l]) stuck[stucks++] = pending[i + l];
    }
    for (int singular = 1; singular >= 0; --singular) {
      const int *rows = singular ? stuck : held;
      const int number = singular ? stucks : helds;
      for (int i = 0; i < number; i += W) {
        V x[COLUMNS], y[A];
        const int some = number - i < W ? number - i : (int)W;
        lane_in(b, rows + i, some, x);
        M on = M{};
        for (int l = 0; l < some; ++l) on[l] = -1;
        if (singular) {
          run_repair(x, job.k_repair, y);
          for (int a = 0; a < A; ++a) x[a] = y[a];
        }
        Found found = newton<false>(job, x, on, job.steps);
        if (found.steps > job.taken) job.taken = found.steps;
        store(job, b, rows + i, on, x, found.check, singular ? SINGULAR : CONVERGED);
      }
    }
    const double *out = (const double *)b.out;
    for (int i = 0; i < count; ++i)
      for (int a = 0; a < A; ++a) job.positions[(from + i) * A + a] = out[a * LINE + i];
    __builtin_memcpy(job.distance + from, out + A * LINE, count * sizeof(double));
    __builtin_memcpy(job.axis_angle_rad + from, out + (A + 1) * LINE, count * sizeof(double));
    __builtin_memcpy(job.code + from, b.code, count);
  }
}
