/* --- What follows is the same for every machine ------------------------------------------------- */

#include "rtapi.h"
#include "rtapi_app.h"
#include "rtapi_math.h"
#include "hal.h"
#include "emcpos.h"
#include "kinematics.h"

MODULE_LICENSE("GPL");

#define ITERATIONS 16             /* of the forward kinematics, at most; two or three are usual */
#define SOLVED 2e-13              /* m, rad: residual at which the forward kinematics is solved */

typedef struct {
    hal_bit_t *enable, *orientation, *heartbeat, *out_of_range, *stale;
    hal_float_t *tool[3], *command[AXES], *correction[AXES], *fade, *seconds, *channel[CHANNELS + 1];
    hal_float_t fade_rate, reversal_rate, tool_rate, heartbeat_timeout, reversal_distance[AXES];
} Pins;

/* What the correction depends on besides the positions; changed by update() alone, by small steps. */
typedef struct {
    double fade, orientation, tool[3];
    double channels[AXES + CHANNELS + HISTORIES + 1];
    double turned[AXES], side[AXES], nominal[AXES], history[HISTORIES + 1];
    double silent;                /* s since the heartbeat changed */
    int started, outside, beat;
} State;

static Pins *pins;
static State state;
static int component, kinematics_type;

static double within(double value, double low, double high) { return fmin(fmax(value, low), high); }
static double towards(double value, double target, double step) { return value + within(target - value, -step, step); }

/* Correction (m, rad) of the commands at positions (m, rad); whether it is cut at its bound. */
static int correct(const double *position, double *correction)
{
    const double *arguments[4] = {position, state.channels, state.tool, &state.orientation};
    double *results[1] = {correction};
    int i, cut = 0;

    twin_correction(arguments, results, 0, 0, 0);
    for (i = 0; i < AXES; i++) {
        cut |= fabs(correction[i]) > LARGEST[i];
        correction[i] = state.fade * within(correction[i], -LARGEST[i], LARGEST[i]);
    }
    return cut;
}

/* The positions whose corrected commands are given: Broyden's method, from the identity. */
static void uncorrect(const double *command, double *position)
{
    double inverse[AXES][AXES] = {{0}}, correction[AXES], residual[AXES], move[AXES], change[AXES], image[AXES], row[AXES];
    double largest, scale, last;
    int i, k, turn;

    for (i = 0; i < AXES; i++) { inverse[i][i] = 1.0; position[i] = command[i]; }
    correct(position, correction);
    for (i = 0; i < AXES; i++) residual[i] = position[i] + correction[i] - command[i];
    for (turn = 0; turn < ITERATIONS; turn++) {
        for (i = 0; i < AXES; i++) {
            move[i] = 0.0;
            for (k = 0; k < AXES; k++) move[i] -= inverse[i][k] * residual[k];
            position[i] += move[i];
        }
        correct(position, correction);
        for (i = 0, largest = 0.0; i < AXES; i++) {
            last = residual[i];
            residual[i] = position[i] + correction[i] - command[i];
            change[i] = residual[i] - last;
            largest = fmax(largest, fabs(residual[i]));
        }
        if (largest <= SOLVED) return;
        for (i = 0, scale = 0.0; i < AXES; i++) {
            image[i] = row[i] = 0.0;
            for (k = 0; k < AXES; k++) { image[i] += inverse[i][k] * change[k]; row[i] += move[k] * inverse[k][i]; }
            scale += move[i] * image[i];
        }
        if (scale <= 0.0) return;
        for (i = 0; i < AXES; i++)
            for (k = 0; k < AXES; k++) inverse[i][k] += (move[i] - image[i]) * row[k] / scale;
    }
}

static void read_pose(const EmcPose *pose, double *position)
{
    const double words[9] = {pose->tran.x, pose->tran.y, pose->tran.z, pose->a, pose->b, pose->c, pose->u, pose->v, pose->w};
    int i;
    for (i = 0; i < AXES; i++) position[i] = words[WORD[i]] * SCALE[i];
}

static void write_pose(const double *position, EmcPose *pose)
{
    double *words[9] = {&pose->tran.x, &pose->tran.y, &pose->tran.z, &pose->a, &pose->b, &pose->c, &pose->u, &pose->v, &pose->w};
    int i;
    for (i = 0; i < AXES; i++) *words[WORD[i]] = position[i] / SCALE[i];
}

/* Positions of the linear axes from the coordinates of the workpiece, and back, without errors. The control has added the tool to the
   coordinates already. */
static void transform(int to_axes, double *position)
{
    double tool[3], result[3];
    const double *arguments[2] = {position, tool};
    double *results[1] = {result};
    int i;

    for (i = 0; i < 3; i++) tool[i] = *pins->tool[i] * 1e-3;
    if (to_axes) {
        for (i = 0; i < 3; i++) position[LINEAR[i]] -= tool[i];
        twin_to_axes(arguments, results, 0, 0, 0);
    } else {
        twin_to_workpiece(arguments, results, 0, 0, 0);
        for (i = 0; i < 3; i++) result[i] += tool[i];
    }
    for (i = 0; i < 3; i++) position[LINEAR[i]] = result[i];
}

int kinematicsInverse(const EmcPose *pose, double *joints, const KINEMATICS_INVERSE_FLAGS *iflags, KINEMATICS_FORWARD_FLAGS *fflags)
{
    double position[AXES], correction[AXES];
    int i;
    (void)iflags; (void)fflags;
    read_pose(pose, position);
    for (i = 0; i < AXES; i++) if (!isfinite(position[i])) return -1;
    if (kinematics_type == 1) transform(1, position);
    correct(position, correction);
    for (i = 0; i < AXES; i++) joints[i] = (position[i] + correction[i]) / SCALE[i];
    return 0;
}

int kinematicsForward(const double *joints, EmcPose *pose, const KINEMATICS_FORWARD_FLAGS *fflags, KINEMATICS_INVERSE_FLAGS *iflags)
{
    double command[AXES], position[AXES];
    int i;
    (void)iflags; (void)fflags;
    for (i = 0; i < AXES; i++) {
        command[i] = joints[i] * SCALE[i];
        if (!isfinite(command[i])) return -1;
    }
    uncorrect(command, position);
    if (kinematics_type == 1) transform(0, position);
    write_pose(position, pose);
    return 0;
}

KINEMATICS_TYPE kinematicsType(void) { return KINEMATICS_BOTH; }
int kinematicsSwitchable(void) { return AXES > 3; }
/* 0: axis words, 1: coordinates of the workpiece. */
int kinematicsSwitch(int type)
{
    if (type != 0 && type != 1) return -1;
    kinematics_type = type;
    return 0;
}

/* Side from which every axis approaches its position: it changes when the axis has moved back by more than the distance. */
static void follow_sides(const double *position, double step)
{
    int i;
    for (i = 0; i < AXES; i++) {
        double distance = pins->reversal_distance[i] * SCALE[i];
        if (!state.started) state.turned[i] = position[i];
        /* turned: the farthest position in the present direction; unknown at first. */
        if (position[i] > state.turned[i] + (state.side[i] > 0.0 ? 0.0 : distance)) {
            state.side[i] = 1.0; state.turned[i] = position[i];
        } else if (position[i] < state.turned[i] - (state.side[i] < 0.0 ? 0.0 : distance)) {
            state.side[i] = -1.0; state.turned[i] = position[i];
        }
        state.channels[i] = towards(state.channels[i], state.side[i], step);
    }
}

static void follow_channels(double seconds)
{
    double drives[HISTORIES + 1];
    const double *arguments[1] = {state.channels};
    double *results[1] = {drives};
    int i, outside = 0, begun = !state.started;
    for (i = 0; i < CHANNELS; i++) {
        double value = *pins->channel[i], *held = &state.channels[AXES + i];
        /* A sensor that fails has a value far outside, often: the last one within is the best estimate. */
        if (!(value >= CHANNEL_LOW[i] && value <= CHANNEL_HIGH[i])) { outside = 1; value = *held; }
        /* A sensor that comes after the control has started: the value before was none. */
        begun |= state.fade == 0.0 && fabs(value - *held) > CHANNEL_RATE[i];
        *held = state.fade > 0.0 ? towards(*held, value, CHANNEL_RATE[i] * seconds) : value;
    }
    if (HISTORIES) twin_drives(arguments, results, 0, 0, 0);
    for (i = 0; i < HISTORIES; i++) {
        if (!state.started) state.history[i] = 0.0;
        if (begun && HISTORY_SETTLED[i]) state.history[i] = drives[i];
        state.history[i] += (drives[i] - state.history[i]) * (1.0 - exp(-seconds / HISTORY_CONSTANT[i]));
        state.channels[AXES + CHANNELS + i] = state.history[i];
    }
    state.outside |= outside;
}

/* Whoever supplies the channels changes the heartbeat as long as all of them are new. */
static void follow_heartbeat(double seconds)
{
    state.silent = *pins->heartbeat == state.beat ? state.silent + seconds : 0.0;
    state.beat = *pins->heartbeat;
    *pins->stale = pins->heartbeat_timeout > 0.0 && state.silent > pins->heartbeat_timeout;
}

static void update(void *unused, long period)
{
    double seconds = period * 1e-9, correction[AXES];
    int i, turn;
    (void)unused;
    state.outside = 0;
    /* Where the axes are meant to be, to some 0.01 µm: twice, because a rapid changes the correction by micrometres a cycle. */
    for (turn = 0; turn < 2; turn++) {
        state.outside |= correct(state.nominal, correction);
        for (i = 0; i < AXES; i++) {
            double command = *pins->command[i] * SCALE[i];
            if (isfinite(command)) state.nominal[i] = command - correction[i];
            else state.outside = 1;
        }
    }
    for (i = 0; i < AXES; i++) {
        if (state.nominal[i] < DOMAIN_LOW[i] || state.nominal[i] > DOMAIN_HIGH[i]) state.outside = 1;
        *pins->correction[i] = correction[i] / SCALE[i];
    }
    follow_sides(state.nominal, pins->reversal_rate * seconds);
    follow_channels(seconds);
    follow_heartbeat(seconds);
    for (i = 0; i < 3; i++) {
        double tool = isfinite(*pins->tool[i]) ? *pins->tool[i] * 1e-3 : state.tool[i];
        if (!isfinite(*pins->tool[i])) state.outside = 1;
        state.tool[i] = state.fade > 0.0 ? towards(state.tool[i], tool, pins->tool_rate * 1e-3 * seconds) : tool;
    }
    state.orientation = state.fade > 0.0 ? towards(state.orientation, *pins->orientation, pins->fade_rate * seconds) : *pins->orientation;
    state.fade = towards(state.fade, *pins->enable, pins->fade_rate * seconds);
    state.started = 1;
    *pins->fade = state.fade;
    *pins->seconds += seconds;
    *pins->out_of_range = state.outside;
}

static int export_pins(void)
{
    const char *xyz = "xyz";
    int i, failed = 0;
    failed |= hal_pin_bit_newf(HAL_IN, &pins->enable, component, NAME ".enable");
    failed |= hal_pin_bit_newf(HAL_IN, &pins->orientation, component, NAME ".orientation");
    failed |= hal_pin_bit_newf(HAL_OUT, &pins->out_of_range, component, NAME ".out-of-range");
    failed |= hal_pin_bit_newf(HAL_IN, &pins->heartbeat, component, NAME ".heartbeat");
    failed |= hal_pin_bit_newf(HAL_OUT, &pins->stale, component, NAME ".stale");
    failed |= hal_pin_float_newf(HAL_OUT, &pins->fade, component, NAME ".fade");
    failed |= hal_pin_float_newf(HAL_OUT, &pins->seconds, component, NAME ".seconds");
    for (i = 0; i < 3; i++) failed |= hal_pin_float_newf(HAL_IN, &pins->tool[i], component, NAME ".tool-%c", xyz[i]);
    for (i = 0; i < AXES; i++) {
        failed |= hal_pin_float_newf(HAL_IN, &pins->command[i], component, NAME ".command-%d", i);
        failed |= hal_pin_float_newf(HAL_OUT, &pins->correction[i], component, NAME ".correction-%d", i);
        failed |= hal_param_float_newf(HAL_RW, &pins->reversal_distance[i], component, NAME ".reversal-distance-%d", i);
        pins->reversal_distance[i] = REVERSAL_DISTANCE[i];
    }
    for (i = 0; i < CHANNELS; i++) {
        failed |= hal_pin_float_newf(HAL_IN, &pins->channel[i], component, NAME ".%s", CHANNEL_NAME[i]);
        if (!failed) *pins->channel[i] = state.channels[AXES + i] = CHANNEL_START[i];
    }
    failed |= hal_param_float_newf(HAL_RW, &pins->fade_rate, component, NAME ".fade-rate");
    failed |= hal_param_float_newf(HAL_RW, &pins->reversal_rate, component, NAME ".reversal-rate");
    failed |= hal_param_float_newf(HAL_RW, &pins->tool_rate, component, NAME ".tool-rate");
    failed |= hal_param_float_newf(HAL_RW, &pins->heartbeat_timeout, component, NAME ".heartbeat-timeout");
    pins->fade_rate = 1.0;       /* 1/s */
    pins->reversal_rate = 20.0;  /* 1/s: from one side to the other in 0.1 s */
    pins->tool_rate = 500.0;     /* mm/s */
    pins->heartbeat_timeout = 0; /* s; 0: nothing is expected */
    if (!failed) *pins->orientation = 1;
    return failed;
}

int rtapi_app_main(void)
{
    component = hal_init(NAME);
    if (component < 0) return component;
    pins = hal_malloc(sizeof(Pins));
    if (!pins || export_pins() || hal_export_funct(NAME ".update", update, 0, 1, 0, component)) {
        hal_exit(component);
        return -1;
    }
    hal_ready(component);
    return 0;
}

void rtapi_app_exit(void) { hal_exit(component); }

EXPORT_SYMBOL(kinematicsType);
EXPORT_SYMBOL(kinematicsSwitchable);
EXPORT_SYMBOL(kinematicsSwitch);
EXPORT_SYMBOL(kinematicsForward);
EXPORT_SYMBOL(kinematicsInverse);
