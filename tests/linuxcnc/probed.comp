component probed "A machine with errors, spheres on its table and a touch probe in its spindle; the formulas share no code with twin";
pin in float motor-# [5] "positions of the motors X Y Z B C, mm and degrees";
pin out bit touched "state of the probe";
pin out float tip-# [3] "true centre of the stylus ball on the workpiece, mm";
pin out float axis-# [3] "true direction of the tool axis on the workpiece";
pin in float reflector "number of the reflector that a tracker looks at";
pin out float seen-# [3] "where it is, in the base of the machine, mm";
pin out s32 contacts "number of contacts so far";
param rw float home-# [5] "where the axes stand when the motors are at zero, mm and degrees";
param rw float length = 120 "true distance of the ball from the spindle nose, mm";
param rw float offset-x = 0 "of the ball from the axis of the spindle, mm";
param rw float offset-y = 0;
param rw float ball-radius = 3;
param rw float pretravel = 0 "mm";
param rw float lobing = 0 "amplitude of its three lobes, mm";
param rw float noise = 0 "standard deviation of a contact, mm";
param rw u32 seed = 1;
param rw float backlash-# [5] "play of an axis, mm and degrees";
param rw s32 missed = 0 "number of a contact at which the probe is silent";
param rw s32 sham = 0 "number of a contact that comes too early";
param rw float early = 0 "by how much, mm";
param rw s32 bumped = 0 "number of the contact after which a sphere is pushed aside";
param rw s32 bumped-sphere = 0;
param rw float bump-# [3] "by how much, mm";
variable double play[5];
variable int started;
variable int armed;
variable double drawn;
variable rtapi_u32 state;
function _;
license "GPL";
;;
#include <rtapi_math.h>
/* numbers of the machine, written by the test: SCALE[3], SQUARE[3] (E_C0Y, E_A0Z, E_B0Z), LOCATION[2][6] of B and C, CURVES[5][6][8],
   RANGES[5][2], SPHERES, PLACES[][3], RADIUS, REFLECTORS, ON_TABLE[], REFLECTED[][3]; mm and radians */
#include "numbers.h"

#define PIVOT 154.996
#define PI 3.14159265358979323846

/* A pose: rotation (3, 3), then shift (3). */
typedef struct { double r[3][3], t[3]; } pose;

static pose start(void) {
    pose p = {{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, {0, 0, 0}};
    return p;
}

static void shift(pose *p, double x, double y, double z) {
    for (int i = 0; i < 3; i++) p->t[i] += p->r[i][0] * x + p->r[i][1] * y + p->r[i][2] * z;
}

/* Turn by a rotation vector. */
static void turn(pose *p, double a, double b, double c) {
    double w = sqrt(a * a + b * b + c * c);
    if (w == 0.0) return;
    double n[3] = {a / w, b / w, c / w}, s = sin(w), k = 2.0 * sin(0.5 * w) * sin(0.5 * w);
    double m[3][3], old[3];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) m[i][j] = k * n[i] * n[j] + (i == j ? 1.0 - k : 0.0);
    m[2][1] += s * n[0]; m[1][2] -= s * n[0];
    m[0][2] += s * n[1]; m[2][0] -= s * n[1];
    m[1][0] += s * n[2]; m[0][1] -= s * n[2];
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) old[j] = p->r[i][j];
        for (int j = 0; j < 3; j++) p->r[i][j] = old[0] * m[0][j] + old[1] * m[1][j] + old[2] * m[2][j];
    }
}

static void off(pose *p, const double e[6]) {
    shift(p, e[0], e[1], e[2]);
    turn(p, e[3], e[4], e[5]);
}

#ifdef TOOL_CHAIN
/* Another machine, without errors: its two chains as statements. */
static pose tool_side(const double q[5]) { pose p = start(); TOOL_CHAIN return p; }
static pose work_side(const double q[5]) { pose p = start(); WORK_CHAIN return p; }
#else
/* Error motions of an axis: cosines over the range of X, Y, Z and B, harmonics of C. */
static void errors_of(int axis, double q, double e[6]) {
    double u = axis == 4 ? q * PI / 180.0 : PI * (q - RANGES[axis][0]) / (RANGES[axis][1] - RANGES[axis][0]);
    for (int i = 0; i < 6; i++) {
        e[i] = 0.0;
        for (int k = 0; k < 4; k++) {
            e[i] += CURVES[axis][i][2 * k] * cos((k + 1) * u);
            if (axis == 4) e[i] += CURVES[axis][i][2 * k + 1] * sin((k + 1) * u);
        }
    }
    if (axis < 3) e[axis] += SCALE[axis] * q;
    if (axis == 1) e[0] -= SQUARE[0] * q;
    if (axis == 2) { e[1] -= SQUARE[1] * q; e[0] += SQUARE[2] * q; }
}

static pose tool_side(const double q[5]) {
    double e[6];
    pose p = start();
    shift(&p, -250.0, -225.0, 400.0);
    for (int axis = 0; axis < 3; axis++) {
        shift(&p, axis == 0 ? q[0] : 0.0, axis == 1 ? q[1] : 0.0, axis == 2 ? q[2] : 0.0);
        errors_of(axis, q[axis], e);
        off(&p, e);
    }
    return p;
}

static pose work_side(const double q[5]) {
    double e[6];
    pose p = start();
    shift(&p, 0.0, 0.0, PIVOT);
    turn(&p, PI / 4.0, 0.0, 0.0);
    off(&p, LOCATION[0]);
    errors_of(3, q[3], e);
    off(&p, e);
    turn(&p, 0.0, 0.0, q[3] * PI / 180.0);
    turn(&p, -PI / 4.0, 0.0, 0.0);
    shift(&p, 0.0, 0.0, -PIVOT);
    off(&p, LOCATION[1]);
    errors_of(4, q[4], e);
    off(&p, e);
    turn(&p, 0.0, 0.0, -q[4] * PI / 180.0);
    return p;
}
#endif

static double uniform(rtapi_u32 *draw) {
    *draw ^= *draw << 13; *draw ^= *draw >> 17; *draw ^= *draw << 5;
    return (*draw + 0.5) / 4294967296.0;
}

static double normal(rtapi_u32 *draw) {
    double radius = sqrt(-2.0 * log(uniform(draw)));
    return radius * cos(2.0 * PI * uniform(draw));
}

FUNCTION(_) {
    double q[5], apart[3], nearest = 1e9, reach = 0.0;
    for (int i = 0; i < 5; i++) {
        double half = 0.5 * backlash(i), driven = home(i) + motor(i);
        if (!started) play[i] = driven;
        if (play[i] < driven - half) play[i] = driven - half;
        if (play[i] > driven + half) play[i] = driven + half;
        q[i] = play[i];
    }
    if (!started) { started = armed = 1; state = 2463534242u ^ (seed * 2654435761u); for (int i = 0; i < 9; i++) uniform(&state); drawn = noise * normal(&state); }
    pose tool = tool_side(q), work = work_side(q), ball = tool;
    shift(&ball, offset_x, offset_y, -length);
    for (int i = 0; i < 3; i++) {
        double point = 0.0, direction = 0.0;
        for (int j = 0; j < 3; j++) {
            point += work.r[j][i] * (ball.t[j] - work.t[j]);
            direction += work.r[j][i] * tool.r[j][2];
        }
        tip(i) = point;
        axis(i) = direction;
    }
    int looked_at = (int)floor(reflector + 0.5);
    if (looked_at >= 0 && looked_at < REFLECTORS) {
        const double *place = REFLECTED[looked_at];
        pose centre = ON_TABLE[looked_at] ? work : tool;
        shift(&centre, place[0], place[1], place[2]);
        for (int i = 0; i < 3; i++) seen(i) = centre.t[i];
    }
    for (int s = 0; s < SPHERES; s++) {
        pose centre = work;
        double moved = bumped > 0 && contacts >= bumped && s == bumped_sphere ? 1.0 : 0.0, gap = 0.0, local[3];
        shift(&centre, PLACES[s][0] + moved * bump(0), PLACES[s][1] + moved * bump(1), PLACES[s][2] + moved * bump(2));
        for (int i = 0; i < 3; i++) { apart[i] = ball.t[i] - centre.t[i]; gap += apart[i] * apart[i]; }
        gap = sqrt(gap);
        if (gap - RADIUS > nearest) continue;
        nearest = gap - RADIUS;
        for (int i = 0; i < 3; i++) local[i] = (tool.r[0][i] * apart[0] + tool.r[1][i] * apart[1] + tool.r[2][i] * apart[2]) / gap;
        double across = sqrt(local[0] * local[0] + local[1] * local[1]), c = across > 0.0 ? local[0] / across : 1.0;
        /* cos 3φ = 4 cos³ φ − 3 cos φ */
        reach = ball_radius - pretravel - lobing * across * (4.0 * c * c * c - 3.0 * c);
    }
    int next = contacts + 1, now = nearest < reach + drawn + (next == sham ? early : 0.0) && next != missed;
    if (armed && now) { armed = 0; touched = 1; contacts = next; }
    if (!armed && nearest > reach + early + 0.05) { armed = 1; touched = 0; drawn = noise * normal(&state); }
}
