/* An independent plant for the plant link: three syringes, three rubber bellows, one IMU, written from the physics in C.
 *
 *     cc -O2 -o plant plant.c -lm
 *     retroflex evaluate --plant 'exec:./plant --effect leak --seed 3'
 *     ./plant --base-imu --effect base_motion.sway    adds an IMU on the base, mounted within 3 degrees of the tip's
 *     ./plant --list                      prints the names that --effect accepts
 *     ./plant --calib --seed 3            prints the gains of that unit as a calibration file
 *
 * The equations are not those of the Rust code: line pressure is a state found by a force balance, memory effects use other
 * operators (Dahl friction for hysteresis, a Prony series for creep, two compartments for the line), and the tip rotation is
 * composed from the platform's tilt. Sizes are drawn per seed from the ranges in which such tips are found. Units: mm, N, kPa,
 * s, rad, m/s^2, uT. `--size X` scales the drawn size of the effect.
 */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define PI 3.14159265358979323846
#define SUB 5 /* inner steps per sample */
static const double PERIOD = 0.005, STEP_MM = PI * 30.0 / 3200.0, REST_LENGTH = 20.0;

/* ---- random numbers: splitmix64 ---- */
static uint64_t rng_state, noise_state;
static double uniform_of(uint64_t *s) {
    uint64_t z = (*s += 0x9e3779b97f4a7c15ULL);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ULL;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebULL;
    return ((z ^ (z >> 31)) >> 11) * (1.0 / 9007199254740992.0);
}
static double draw(double lo, double hi) { return lo + (hi - lo) * uniform_of(&rng_state); }
static double gauss_of(uint64_t *s) {
    double u = uniform_of(s), v = uniform_of(s);
    return sqrt(-2.0 * log(u + 1e-300)) * cos(2.0 * PI * v);
}
static double sign_draw(void) { return draw(0, 1) < 0.5 ? -1.0 : 1.0; }

/* ---- rotations as 3x3 matrices ---- */
typedef struct { double m[3][3]; } Rot;
typedef struct { double v[3]; } Vec;
static const Rot IDENTITY = {{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};
static Rot mul(Rot a, Rot b) {
    Rot c;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            c.m[i][j] = 0;
            for (int k = 0; k < 3; k++) c.m[i][j] += a.m[i][k] * b.m[k][j];
        }
    return c;
}
static Rot transpose(Rot a) {
    Rot c;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) c.m[i][j] = a.m[j][i];
    return c;
}
static Vec apply(Rot a, Vec x) {
    Vec y;
    for (int i = 0; i < 3; i++) y.v[i] = a.m[i][0] * x.v[0] + a.m[i][1] * x.v[1] + a.m[i][2] * x.v[2];
    return y;
}
/* Rodrigues' formula */
static Rot about(double x, double y, double z, double angle) {
    double n = sqrt(x * x + y * y + z * z);
    if (n < 1e-12 || fabs(angle) < 1e-15) return IDENTITY;
    x /= n, y /= n, z /= n;
    double c = cos(angle), s = sin(angle), t = 1 - c;
    Rot r = {{{t * x * x + c, t * x * y - s * z, t * x * z + s * y},
              {t * x * y + s * z, t * y * y + c, t * y * z - s * x},
              {t * x * z - s * y, t * y * z + s * x, t * z * z + c}}};
    return r;
}
static Vec rotation_vector(Rot r) {
    double trace = r.m[0][0] + r.m[1][1] + r.m[2][2];
    double c = fmax(-1.0, fmin(1.0, (trace - 1) / 2)), angle = acos(c);
    double k = angle < 1e-7 ? 0.5 : angle / (2 * sin(angle));
    Vec v = {{k * (r.m[2][1] - r.m[1][2]), k * (r.m[0][2] - r.m[2][0]), k * (r.m[1][0] - r.m[0][1])}};
    return v;
}
/* Shepperd's method */
static void quaternion(Rot r, double q[4]) {
    double t = r.m[0][0] + r.m[1][1] + r.m[2][2];
    if (t > 0) {
        double s = 2 * sqrt(t + 1);
        q[0] = s / 4, q[1] = (r.m[2][1] - r.m[1][2]) / s, q[2] = (r.m[0][2] - r.m[2][0]) / s, q[3] = (r.m[1][0] - r.m[0][1]) / s;
        return;
    }
    int i = r.m[1][1] > r.m[0][0] ? 1 : 0;
    if (r.m[2][2] > r.m[i][i]) i = 2;
    int j = (i + 1) % 3, k = (i + 2) % 3;
    double s = 2 * sqrt(1 + r.m[i][i] - r.m[j][j] - r.m[k][k]);
    q[0] = (r.m[k][j] - r.m[j][k]) / s;
    q[1 + i] = s / 4, q[1 + j] = (r.m[j][i] + r.m[i][j]) / s, q[1 + k] = (r.m[k][i] + r.m[i][k]) / s;
}

/* ---- effects ---- */
enum {
    NONE, MISSED_STEPS, GEAR_PERIODIC, LEAK, GAS_COMPRESSION, LINE_LAG, THERMAL_DRIFT, CROSSTALK, STIFFENING, ASYMMETRY,
    HYSTERESIS, CREEP, SOFTENING, GRAVITY, CURVATURE, CLOCKING, CABLE_STIFFNESS, TORSION, CONTACT, GYRO_BIAS, ACCEL_BIAS,
    HARD_IRON, MOTOR_FIELD, MOUNT_MISALIGNMENT, TRANSPORT_DELAY, SENSOR_LATENCY, BASE_MOTION,
    /* outside the catalogue */
    STICK_SLIP, RESPIRATION, PINCH, SWAY, SOFT_WALL, WALL_RELEASE, SHORT_REACH, EFFECTS
};
static const char *NAMES[EFFECTS] = {
    "none", "missed_steps", "gear_periodic", "leak", "gas_compression", "line_lag", "thermal_drift", "crosstalk", "stiffening",
    "asymmetry", "hysteresis", "creep", "softening", "gravity", "curvature", "clocking", "cable_stiffness", "torsion", "contact",
    "gyro_bias", "accel_bias", "hard_iron", "motor_field", "mount_misalignment", "transport_delay", "sensor_latency",
    "base_motion", "stick_slip", "respiration", "pinch", "base_motion.sway", "contact.soft", "wall_release", "short_reach"};
static int active[EFFECTS];
static int calibrated; /* the sensors' constant errors are those that a calibration leaves */
static double size = 1.0, value_override = NAN;
/* The effect's main figure: drawn from its range, scaled, or given outright with --value. */
static double figure(double lo, double hi) {
    double x = draw(lo, hi) * size;
    return isnan(value_override) ? x : value_override;
}

/* ---- the unit ---- */
static double ratio[3], half_play[3], r_mm, lag_s;
static double gyro_bias0[3], acc_bias[3], iron[3], base_bias[3];
static Rot base0, mount, base_mount;
static Vec field_world;
/* effect parameters */
static double p_gear, p_gear_phase[3], p_leak[3], p_boyle, p_lag, p_lag_down, p_drift[3], p_drift_tau, p_cross, p_stiff, p_asym;
static double p_dahl, p_dahl_x, p_creep, p_soft, p_weight, p_curve, p_clock[3], p_cable, p_cable_dir, p_twist, p_wall, p_wall_dir;
static double p_wall_yield, p_gyro_drift[3], p_gyro_tau, p_coil[3][2][3], p_delay, p_latency, p_base_t[3], p_base_turn[3][3];
static double p_stick[3], p_breath, p_breath_hz, p_breath_dir, p_pinch_t, p_pinch_s, p_sway, p_sway_hz[3], p_release_t;
static int p_pinch_line, p_missed_line, p_missed_n;
static double p_missed_next;

static void draw_unit(void) {
    for (int i = 0; i < 3; i++) {
        ratio[i] = draw(2.7, 3.9); /* piston travel per bellow length change */
        half_play[i] = draw(0.4, 1.2);
        gyro_bias0[i] = 0.007 * gauss_of(&rng_state);
        acc_bias[i] = 0.03 * gauss_of(&rng_state);
        iron[i] = (calibrated ? 0.15 : 0.6) * gauss_of(&rng_state);
    }
    r_mm = 7.0 / sqrt(3.0) * draw(0.96, 1.04);
    lag_s = draw(0.015, 0.045);
    base0 = mul(about(0, 0, 1, draw(-PI, PI)), about(draw(-1, 1), draw(-1, 1), 0.1, draw(0.05, 0.9)));
    double dip = draw(0.9, 1.25), strength = draw(40, 55);
    field_world = (Vec){{strength * cos(dip), 0, -strength * sin(dip)}};
    mount = about(draw(-1, 1), draw(-1, 1), draw(-1, 1), 0.004);

    double dir = draw(-PI, PI);
    p_missed_next = active[MISSED_STEPS] ? draw(20, 60) : 1e9;
    p_missed_line = (int)draw(0, 2.999), p_missed_n = (int)(16 * fmax(1, figure(2, 12)));
    p_gear = active[GEAR_PERIODIC] ? figure(0.05, 0.35) : 0;
    for (int i = 0; i < 3; i++) p_gear_phase[i] = draw(-PI, PI);
    double leak = active[LEAK] ? figure(3e-4, 0.02) : 0;
    for (int i = 0; i < 3; i++) p_leak[i] = leak * draw(0.2, 1);
    p_boyle = active[GAS_COMPRESSION] ? figure(0.05, 0.3) : 0;
    p_lag = active[LINE_LAG] ? figure(0.08, 0.6) : 0, p_lag_down = p_lag * draw(0.8, 1.3);
    double drift = active[THERMAL_DRIFT] ? figure(0.02, 0.14) : 0; /* radians of bend */
    for (int i = 0; i < 3; i++) p_drift[i] = drift * r_mm * cos(dir + 2.1 * i);
    p_drift_tau = draw(40, 300);
    p_cross = active[CROSSTALK] ? figure(0.03, 0.25) : 0;
    p_stiff = active[STIFFENING] ? figure(0.05, 0.3) : 0;
    p_asym = active[ASYMMETRY] ? figure(0.05, 0.4) * sign_draw() : 0;
    p_dahl = active[HYSTERESIS] ? figure(0.05, 0.25) : 0, p_dahl_x = draw(0.5, 1.6);
    p_creep = active[CREEP] ? figure(0.04, 0.3) : 0;
    p_soft = active[SOFTENING] ? figure(0.1, 0.5) : 0;
    p_weight = active[GRAVITY] ? figure(0.02, 0.15) : 0;
    p_curve = active[CURVATURE] ? figure(0.03, 0.18) * sign_draw() : 0;
    double clock = active[CLOCKING] ? figure(0.03, 0.3) * sign_draw() : 0;
    int which = (int)draw(0, 3.999);
    for (int i = 0; i < 3; i++) p_clock[i] = which == 3 || which == i ? clock : 0;
    p_cable = active[CABLE_STIFFNESS] ? figure(0.05, 0.4) : 0, p_cable_dir = draw(0, PI);
    p_twist = active[TORSION] ? figure(0.03, 0.25) * sign_draw() : 0;
    int wall = active[CONTACT] || active[SOFT_WALL] || active[WALL_RELEASE];
    /* a larger wall is a nearer one */
    p_wall = wall ? isnan(value_override) ? draw(0.5, 1.0) / size : value_override : 1e9, p_wall_dir = dir, p_wall_yield = active[SOFT_WALL] ? 0.1 : draw(0.03, 0.2);
    p_release_t = active[WALL_RELEASE] ? draw(60, 120) : 1e9;
    double gyro = active[GYRO_BIAS] ? figure(0.002, 0.03) : 0;
    for (int i = 0; i < 3; i++) p_gyro_drift[i] = gyro * gauss_of(&rng_state);
    p_gyro_tau = draw(20, 120);
    if (active[ACCEL_BIAS]) {
        double a = figure(0.1, 0.8);
        for (int i = 0; i < 3; i++) acc_bias[i] += a * gauss_of(&rng_state) / 1.7;
    }
    if (active[HARD_IRON]) {
        double a = figure(2, 40);
        for (int i = 0; i < 3; i++) iron[i] += a * gauss_of(&rng_state) / 1.7;
    }
    double coil = active[MOTOR_FIELD] ? figure(0.3, 15) : 0;
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 2; k++)
            for (int j = 0; j < 3; j++) p_coil[i][k][j] = coil * gauss_of(&rng_state) / 2.5;
    if (active[MOUNT_MISALIGNMENT]) mount = about(draw(-1, 1), draw(-1, 1), draw(-1, 1), figure(0.02, 0.2));
    p_delay = active[TRANSPORT_DELAY] ? figure(0.02, 0.25) : 0;
    p_latency = active[SENSOR_LATENCY] ? figure(0.02, 0.25) : 0;
    double turn = active[BASE_MOTION] ? figure(0.03, 0.17) : 0;
    for (int k = 0; k < 3; k++) {
        p_base_t[k] = draw(30, 170);
        for (int j = 0; j < 3; j++) p_base_turn[k][j] = turn * gauss_of(&rng_state) / 1.7;
    }
    double stick = active[STICK_SLIP] ? figure(1.6, 2.6) : 0;
    for (int i = 0; i < 3; i++) p_stick[i] = stick * draw(0.8, 1.0);
    p_breath = active[RESPIRATION] ? figure(3, 5) * PI / 180 : 0, p_breath_hz = draw(0.2, 0.33), p_breath_dir = draw(-PI, PI);
    p_pinch_t = active[PINCH] ? draw(50, 90) : 1e9, p_pinch_s = active[PINCH] ? figure(10, 40) : 0;
    p_pinch_line = (int)draw(0, 2.999);
    p_sway = active[SWAY] ? figure(0.05, 0.17) : 0;
    for (int i = 0; i < 3; i++) p_sway_hz[i] = draw(0.05, 0.35);
    base_mount = about(draw(-1, 1), draw(-1, 1), draw(-1, 1), draw(0.01, 0.05));
    for (int i = 0; i < 3; i++) base_bias[i] = 0.007 * gauss_of(&rng_state);
}

/* ---- state ---- */
static double now_s, piston[3], play_out[3], air[3], lost[3], z1[3], z2[3], stretch_max[3], dahl[3], prony[3][4], q_bellow[3];
static double tilt[2], tilt_v[2], stuck[3], idle[3], gyro_walk[3], pinched[3];
static long missed[3];
#define RING 512
static double ring_u[RING][3];
static int ring_at;

static double delayed(double back_s, int i) {
    double n = back_s / (PERIOD / SUB);
    int k = (int)n;
    if (k > RING - 2) k = RING - 2;
    double f = n - k, a = ring_u[(ring_at - k + 2 * RING) % RING][i], b = ring_u[(ring_at - k - 1 + 2 * RING) % RING][i];
    return a + (b - a) * f;
}

/* One bellow: length change that balances rubber and gas for a displaced air length x (mm of piston). */
static double balance(int i, double x) {
    double k = ratio[i], q = x / k;
    if (p_boyle > 0) {
        /* isothermal gas: x is what the piston displaces; the gas gives way by V0 (1 - p0/(p0 + p)), p in atmospheres */
        double volume = (k - 1) * 5 / p_boyle, low = -4.9 / p_boyle, high = 60;
        for (int n = 0; n < 60; n++) {
            double mid = 0.5 * (low + high), p = mid * p_boyle / 5;
            if (mid + volume * (1 - 1 / (1 + p)) < x) low = mid;
            else high = mid;
        }
        q = 0.5 * (low + high);
    }
    if (p_stiff > 0) q = 6.0 / sqrt(3 * p_stiff) * tanh(q * sqrt(3 * p_stiff) / 6.0);
    if (p_asym != 0) q += p_asym * 0.5 * (sqrt(q * q + 0.04) - 0.2);
    return q;
}

static void advance(const long steps[3], double dt) {
    now_s += dt;
    ring_at = (ring_at + 1) % RING;
    for (int i = 0; i < 3; i++) {
        double u = (steps[i] + missed[i]) * STEP_MM, v = (u - ring_u[(ring_at - 1 + RING) % RING][i]) / dt;
        ring_u[ring_at][i] = u;
        if (now_s > p_missed_next && i == p_missed_line && fabs(v) > 5) {
            missed[i] -= (v > 0 ? 1 : -1) * p_missed_n;
            p_missed_next = now_s + 70;
        }
        idle[i] = fabs(v) > 0.01 ? 0 : idle[i] + dt;
        u = delayed(p_delay, i);
        if (p_gear > 0) u += p_gear * (sin(2 * u + p_gear_phase[i]) + 0.3 * sin(4 * u + 1) - sin(p_gear_phase[i]) - 0.3 * sin(1.0));
        /* stick-slip: the seal holds until the rack has wound up, then jumps most of the way */
        if (p_stick[i] > 0) {
            if (fabs(u - stuck[i]) > p_stick[i]) stuck[i] = u - 0.1 * (u - stuck[i]);
            u = stuck[i];
        }
        piston[i] = u;
        /* backlash */
        if (u - play_out[i] > half_play[i]) play_out[i] = u - half_play[i];
        if (u - play_out[i] < -half_play[i]) play_out[i] = u + half_play[i];
        /* air that leaves in proportion to pressure */
        double x = play_out[i] - lost[i];
        lost[i] += p_leak[i] * x * dt;
        /* a pinched line passes nothing */
        if (i == p_pinch_line && now_s > p_pinch_t && now_s < p_pinch_t + p_pinch_s) x = pinched[i];
        pinched[i] = x;
        /* the line: two compartments */
        if (p_lag > 0) {
            double tau = x > z2[i] ? p_lag : p_lag_down;
            z1[i] += (x - z1[i]) * (1 - exp(-dt / (0.25 * tau)));
            z2[i] += (z1[i] - z2[i]) * (1 - exp(-dt / (0.75 * tau)));
        } else z2[i] = x;
        air[i] = z2[i];
    }
    double q[3];
    for (int i = 0; i < 3; i++) {
        double x = air[i];
        if (p_cross > 0) x += 0.5 * p_cross * (fmax(air[(i + 1) % 3], 0) + fmax(air[(i + 2) % 3], 0));
        q[i] = balance(i, x);
        if (p_soft > 0) {
            stretch_max[i] = fmax(stretch_max[i], fabs(q[i]));
            q[i] *= 1 + p_soft * (1 - exp(-stretch_max[i] / 3.0)) * (stretch_max[i] > 0.05 ? 1 : 0);
        }
        /* Dahl: friction that builds up over a stretch */
        if (p_dahl > 0) {
            double dq = q[i] - q_bellow[i], peak = p_dahl * 3.0;
            dahl[i] += dq / p_dahl_x * (1 - (dq > 0 ? dahl[i] : -dahl[i]));
            dahl[i] = fmax(-1, fmin(1, dahl[i]));
            q_bellow[i] = q[i];
            q[i] -= peak * 0.5 * dahl[i];
        }
        if (p_creep > 0) {
            static const double TAU[4] = {1.5, 6, 25, 100};
            double sum = 0;
            for (int n = 0; n < 4; n++) prony[i][n] += (q[i] - prony[i][n]) * (1 - exp(-dt / TAU[n])), sum += prony[i][n];
            q[i] += p_creep * 0.5 * sum / 4 * 2;
        }
        q[i] += p_drift[i] * (1 - exp(-now_s / p_drift_tau));
    }
    /* the platform's tilt: plane through the three bellow ends; tilt = beta (cos delta, sin delta) */
    double cx = 0, cy = 0;
    for (int i = 0; i < 3; i++) {
        double a = 2 * PI * i / 3 + p_clock[i];
        cx += q[i] * cos(a), cy += q[i] * sin(a);
    }
    double want[2] = {-2 * cx / (3 * r_mm), 2 * cy / (3 * r_mm)};
    if (p_cable > 0) {
        double c = cos(p_cable_dir), s = sin(p_cable_dir), along = want[0] * c + want[1] * s, across = -want[0] * s + want[1] * c;
        along /= 1 + p_cable;
        want[0] = along * c - across * s, want[1] = along * s + across * c;
    }
    double beta = hypot(want[0], want[1]);
    if (p_curve != 0 && beta > 1e-9) {
        double k = 1 + p_curve * sin(0.9 * beta);
        want[0] *= k, want[1] *= k;
    }
    if (p_weight > 0) {
        /* the weight pulls the tip towards the vertical below: its moment across the bent tip */
        Vec down = apply(transpose(base0), (Vec){{0, 0, -1}});
        double d = atan2(want[1], want[0]), c = cos(beta), s = sin(beta);
        double axial = down.v[2], radial = down.v[0] * cos(d) - down.v[1] * sin(d), tangent = -(down.v[0] * sin(d) + down.v[1] * cos(d));
        double bend = p_weight * (radial * c - axial * s * 0.6), side = p_weight * tangent * 0.8;
        want[0] += bend * cos(d) - side * sin(d), want[1] += bend * sin(d) + side * cos(d);
    }
    double wall = now_s > p_release_t ? 1e9 : p_wall;
    double over = want[0] * cos(p_wall_dir) + want[1] * sin(p_wall_dir) - wall;
    if (over > 0) {
        want[0] -= (1 - p_wall_yield) * over * cos(p_wall_dir);
        want[1] -= (1 - p_wall_yield) * over * sin(p_wall_dir);
    }
    if (active[SHORT_REACH]) { /* a softened tip that stiffens: 75 degrees are out of reach */
        double b = hypot(want[0], want[1]), most = 1.05;
        if (b > 1e-9) {
            double k = most * tanh(b / most) / b;
            want[0] *= k, want[1] *= k;
        }
    }
    double breath = p_breath * sin(2 * PI * p_breath_hz * fmax(0, now_s - 3)); /* the start is still */
    want[0] += breath * cos(p_breath_dir), want[1] += breath * sin(p_breath_dir);
    /* a well damped second-order tip whose mean delay is lag_s */
    double w = 2.2 / lag_s;
    for (int k = 0; k < 2; k++) {
        double acc = w * w * (want[k] - tilt[k]) - 2.2 * w * tilt_v[k];
        tilt_v[k] += acc * dt, tilt[k] += tilt_v[k] * dt;
    }
}

static Rot base_now(void) {
    Rot r = base0;
    for (int k = 0; k < 3; k++)
        if (active[BASE_MOTION] && now_s > p_base_t[k]) {
            double share = fmin(1, (now_s - p_base_t[k]) / 1.5);
            share = share * share * (3 - 2 * share);
            double *v = p_base_turn[k];
            r = mul(r, about(v[0], v[1], v[2], share * sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])));
        }
    if (p_sway > 0)
        for (int k = 0; k < 3; k++) {
            double ramp = fmin(1, fmax(0, (now_s - 3) / 2));
            r = mul(r, about(k == 0, k == 1, k == 2, ramp * p_sway * 0.8 * sin(2 * PI * p_sway_hz[k] * now_s + k)));
        }
    return r;
}

static Rot tip_in_base(void) {
    double beta = hypot(tilt[0], tilt[1]);
    /* bending turns about the axis that lies across the bend plane */
    Rot r = beta < 1e-12 ? IDENTITY : about(tilt[1] / beta, tilt[0] / beta, 0, beta);
    if (p_twist != 0) r = mul(r, about(0, 0, 1, p_twist * sin(beta)));
    return r;
}

/* Position of the sensor, 5 mm beyond an arc of constant curvature, in mm along base axes. */
static Vec place(void) {
    double beta = hypot(tilt[0], tilt[1]), d = atan2(tilt[1], tilt[0]), across, along;
    if (beta < 1e-6) across = 0, along = REST_LENGTH;
    else across = REST_LENGTH * (1 - cos(beta)) / beta, along = REST_LENGTH * sin(beta) / beta;
    across += 5 * sin(beta), along += 5 * cos(beta);
    return (Vec){{across * cos(d), -across * sin(d), along}};
}

typedef struct { Vec acc, gyr, mag; int has_mag; } Sample;
#define SAMPLES 128
static Sample history[SAMPLES];
static int history_at;

int main(int argc, char **argv) {
    uint64_t seed = 1;
    int print_calib = 0, base_imu = 0;
    for (int i = 1; i < argc; i++) {
        if (!strcmp(argv[i], "--list")) {
            for (int k = 0; k < EFFECTS; k++) puts(NAMES[k]);
            return 0;
        }
        if (!strcmp(argv[i], "--calib")) {
            print_calib = 1;
            continue;
        }
        if (!strcmp(argv[i], "--calibrated")) {
            calibrated = 1;
            continue;
        }
        if (!strcmp(argv[i], "--base-imu")) {
            base_imu = 1;
            continue;
        }
        if (i + 1 >= argc) return fprintf(stderr, "plant: %s needs a value\n", argv[i]), 2;
        if (!strcmp(argv[i], "--seed")) seed = strtoull(argv[++i], NULL, 10);
        else if (!strcmp(argv[i], "--size")) size = atof(argv[++i]);
        else if (!strcmp(argv[i], "--value")) value_override = atof(argv[++i]);
        else if (!strcmp(argv[i], "--effect")) {
            char *name = strtok(argv[++i], ",");
            for (; name; name = strtok(NULL, ",")) {
                int k = 0;
                while (k < EFFECTS && strcmp(NAMES[k], name)) k++;
                if (k == EFFECTS) return fprintf(stderr, "plant: no effect `%s`; --list prints the names\n", name), 2;
                active[k] = 1;
            }
        } else return fprintf(stderr, "plant: unknown option %s\n", argv[i]), 2;
    }
    rng_state = seed * 0x2545f4914f6cdd1dULL + 11, noise_state = rng_state ^ 0x5bf03635ULL;
    draw_unit();
    if (print_calib) {
        printf("[transmission]\nk_epsilon = [%f, %f, %f]\n", ratio[0] - 1, ratio[1] - 1, ratio[2] - 1);
        return printf("k_lambda_mm = [%f, %f, %f]\n", half_play[0], half_play[1], half_play[2]), 0;
    }
    printf("{\"plant\":\"independent\",\"protocol\":1,\"imu_period_s\":%g,\"step_mm\":%.6f,\"rest_length_mm\":%g%s}\n", PERIOD, STEP_MM, REST_LENGTH, base_imu ? ",\"base_imu\":true" : "");
    fflush(stdout);

    static char line[65536];
    Rot rest = IDENTITY, before = IDENTITY, base_before = IDENTITY;
    Vec base_rate = {{0, 0, 0}};
    Vec at[2] = {{{0, 0, 0}}, {{0, 0, 0}}}; /* the last two positions of the sensor in the world */
    long n = 0;
    int started = 0;
    while (fgets(line, sizeof line, stdin)) {
        double t;
        long steps[3];
        char *at_t = strstr(line, "\"t\":"), *at_s = strstr(line, "\"steps\":[");
        if (!at_t || !at_s || sscanf(at_t, "\"t\":%lf", &t) != 1 || sscanf(at_s, "\"steps\":[%ld,%ld,%ld]", &steps[0], &steps[1], &steps[2]) != 3)
            return fprintf(stderr, "plant: cannot read %s", line), 2;
        int sampled = 0;
        Rot tip = IDENTITY;
        if (!started) { /* the sag at rest defines zero */
            long zero[3] = {0, 0, 0};
            for (int k = 0; k < 4000; k++) now_s = 0, advance(zero, PERIOD / SUB);
            now_s = 0;
            memset(lost, 0, sizeof lost);
            rest = tip_in_base(), before = mul(base_now(), rest), base_before = base_now(), started = 1;
            at[0] = at[1] = apply(base_now(), place());
        }
        while ((n + 1) * PERIOD <= t + 1e-9) {
            n++;
            for (int k = 0; k < SUB; k++) advance(steps, PERIOD / SUB);
            tip = tip_in_base();
            Rot world = mul(base_now(), tip), sensor = mul(world, mount);
            Vec rate = rotation_vector(mul(transpose(mul(before, mount)), sensor));
            before = world;
            base_rate = rotation_vector(mul(transpose(mul(base_before, base_mount)), mul(base_now(), base_mount)));
            base_before = base_now();
            Vec here = apply(base_now(), place()), force = {{0, 0, 9.81}};
            for (int j = 0; j < 3; j++) {
                force.v[j] += (here.v[j] - 2 * at[0].v[j] + at[1].v[j]) / (PERIOD * PERIOD) * 1e-3;
                at[1].v[j] = at[0].v[j], at[0].v[j] = here.v[j];
            }
            Vec up = apply(transpose(sensor), force), mag = apply(transpose(sensor), field_world);
            Vec coils = {{0, 0, 0}};
            for (int i = 0; i < 3; i++) {
                double phase = 2 * PI * (double)(steps[i] % 64) / 64, current = idle[i] > 0.5 ? 0.5 : 1;
                for (int j = 0; j < 3; j++) coils.v[j] += current * (p_coil[i][0][j] * cos(phase) + p_coil[i][1][j] * sin(phase));
            }
            coils = apply(transpose(sensor), apply(base0, coils));
            Sample *s = &history[history_at = (history_at + 1) % SAMPLES];
            s->has_mag = n % 2 == 0;
            for (int j = 0; j < 3; j++) {
                gyro_walk[j] += 3e-5 * sqrt(PERIOD) * gauss_of(&noise_state);
                double drift = p_gyro_drift[j] * (1 - exp(-now_s / p_gyro_tau));
                s->gyr.v[j] = rate.v[j] / PERIOD + gyro_bias0[j] + drift + gyro_walk[j] + 0.004 * gauss_of(&noise_state);
                s->acc.v[j] = up.v[j] + acc_bias[j] + 0.04 * gauss_of(&noise_state);
                s->mag.v[j] = mag.v[j] + iron[j] + coils.v[j] + 0.5 * gauss_of(&noise_state);
            }
            sampled = 1;
        }
        double q[4];
        tip = tip_in_base();
        quaternion(mul(transpose(rest), tip), q);
        printf("{\"t\":%.6f,\"imu\":", t);
        long back = lround(p_latency / PERIOD);
        if (sampled && n > back) {
            Sample *s = &history[(history_at - back + 4 * SAMPLES) % SAMPLES];
            printf("{\"acc\":[%.6f,%.6f,%.6f],\"gyr\":[%.7f,%.7f,%.7f],\"mag\":", s->acc.v[0], s->acc.v[1], s->acc.v[2], s->gyr.v[0], s->gyr.v[1], s->gyr.v[2]);
            if (s->has_mag) printf("[%.4f,%.4f,%.4f]}", s->mag.v[0], s->mag.v[1], s->mag.v[2]);
            else printf("null}");
        } else printf("null");
        if (base_imu && sampled && n > back) {
            /* the base sensor's axes are those of the tip's at rest */
            Rot sensor = mul(mul(base_now(), rest), base_mount);
            Vec a = apply(transpose(sensor), (Vec){{0, 0, 9.81}}), m = apply(transpose(sensor), field_world);
            Vec g = apply(transpose(base_mount), apply(transpose(rest), apply(base_mount, base_rate)));
            for (int j = 0; j < 3; j++) {
                a.v[j] += 0.04 * gauss_of(&noise_state);
                g.v[j] = g.v[j] / PERIOD + base_bias[j] + 0.004 * gauss_of(&noise_state);
                m.v[j] += 0.5 * gauss_of(&noise_state);
            }
            printf(",\"base\":{\"acc\":[%.6f,%.6f,%.6f],\"gyr\":[%.7f,%.7f,%.7f],\"mag\":[%.4f,%.4f,%.4f]}", a.v[0], a.v[1], a.v[2],
                   g.v[0], g.v[1], g.v[2], m.v[0], m.v[1], m.v[2]);
        }
        printf(",\"ref\":{\"quat\":[%.9f,%.9f,%.9f,%.9f]", q[0], q[1], q[2], q[3]);
        if (base_imu) {
            quaternion(mul(transpose(base0), base_now()), q);
            printf(",\"base_quat\":[%.9f,%.9f,%.9f,%.9f]", q[0], q[1], q[2], q[3]);
        }
        printf("}}\n");
        fflush(stdout);
    }
    return 0;
}
