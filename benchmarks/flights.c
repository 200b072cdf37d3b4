/* The guided Mars entry of `comparators.py` in C, eight flights to a vector.

   What a programmer might write who wants this one mission flown as fast as the processor
   allows: the equations of `comparators.rates` on vectors of eight doubles, structure of
   arrays, sine, cosine and exponential as polynomials, the row of the reference read as one
   vector for each flight and turned, classical Runge-Kutta steps of a constant length. A
   flight that ends leaves its place in the vector to the next one; eight that have ended are
   brought to their end together. Threads draw from one count of flights.

   With SPACE defined the flight is in three dimensions, over a sphere that does not turn, with
   latitude and heading as two more states: it begins due east on the equator and banks to the
   right.

   It computes no peaks of path constraints, and has no check for numbers that are not finite
   or for singular points. `comparators.c_program` compiles it; the compiler needs vector
   extensions with `__builtin_shufflevector`, as GCC 12 has them. */

#include <math.h>
#include <pthread.h>
#include <stdatomic.h>

#define LANES 8
#define MAX_THREADS 64

typedef double Vector __attribute__((vector_size(8 * LANES)));
typedef long long Whole __attribute__((vector_size(8 * LANES))); /* or a mask */

/* In the order of `comparators.Mission` and `comparators.Plan`. */
typedef struct {
    double planet_radius, gravitational_parameter, surface_density, scale_height;
    double reference_area, lift_coefficient, drag_coefficient;
    double altitude, velocity, flight_path_angle;
    double end_velocity, end_altitude, time_limit;
    double epsilon0, a, b, epsilon, l1, l2, reference_start, reference_spacing;
} Mission;

typedef struct {
    double planet_radius, gravitational_parameter, per_scale_height, lift_to_drag;
    double feedback_error, feedback_rate, innovation_error, innovation_rate;
    double reference_start, per_spacing, intervals;
} Plan;

/* A row of the reference: six coefficients, highest power first, and what places an energy in
   the interval: x = inside * row[6] - row[7]. */
typedef Vector Row;

typedef struct {
    Vector altitude, downrange, velocity, path, error, error_rate;
#ifdef SPACE
    Vector latitude, turned; /* from due east, to the right */
#endif
} State; /* or its time derivative */

#define INLINE static inline __attribute__((always_inline))

INLINE Vector same(double x) { return x - (Vector){0}; }

INLINE Vector choose(Whole mask, Vector a, Vector b) {
    return (Vector)((mask & (Whole)a) | (~mask & (Whole)b));
}

/* Loops over the elements become one instruction. */
INLINE Vector least(Vector a, Vector b) {
    Vector out;
    for (int i = 0; i < LANES; i++) out[i] = a[i] < b[i] ? a[i] : b[i];
    return out;
}

INLINE Vector greatest(Vector a, Vector b) {
    Vector out;
    for (int i = 0; i < LANES; i++) out[i] = a[i] > b[i] ? a[i] : b[i];
    return out;
}

INLINE Vector root(Vector x) {
    Vector out;
    for (int i = 0; i < LANES; i++) out[i] = sqrt(x[i]);
    return out;
}

/* The nearest whole number, for numbers above -4096: the conversion rounds towards zero. */
INLINE Whole nearest(Vector x) {
    return __builtin_convertvector(x + 4096.5, Whole) - 4096;
}

INLINE Vector as_numbers(Whole x) { return __builtin_convertvector(x, Vector); }

/* exp(x) to 2e-16 of itself where it is a normal number: 2^k times a Taylor polynomial. */
INLINE Vector exponential(Vector x) {
    Whole k = nearest(x * 0x1.71547652b82fep0);
    Vector whole = as_numbers(k);
    Vector r = (x - whole * 0x1.62e42fefa39efp-1) - whole * 0x1.abc9e3b39803fp-56;
    Vector y = same(1.0 / 479001600);
    y = y * r + 1.0 / 39916800;
    y = y * r + 1.0 / 3628800;
    y = y * r + 1.0 / 362880;
    y = y * r + 1.0 / 40320;
    y = y * r + 1.0 / 5040;
    y = y * r + 1.0 / 720;
    y = y * r + 1.0 / 120;
    y = y * r + 1.0 / 24;
    y = y * r + 1.0 / 6;
    y = y * r + 0.5;
    y = y * r + 1.0;
    y = y * r + 1.0;
    return (Vector)((Whole)y + (k << 52));
}

/* Coefficients of the Cephes library on [-pi/4, pi/4]. */
INLINE void sine_cosine(Vector angle, Vector *sine, Vector *cosine) {
    Whole quadrant = nearest(angle * 0x1.45f306dc9c883p-1);
    Vector whole = as_numbers(quadrant);
    Vector x = (angle - whole * 0x1.921fb54442d18p0) - whole * 0x1.1a62633145c07p-54;
    Vector z = x * x;
    Vector s = same(1.58962301576546568060e-10);
    s = s * z - 2.50507477628578072866e-8;
    s = s * z + 2.75573136213857245213e-6;
    s = s * z - 1.98412698295895385996e-4;
    s = s * z + 8.33333333332211858878e-3;
    s = s * z - 1.66666666666666307295e-1;
    s = x + x * z * s;
    Vector c = same(-1.13585365213876817300e-11);
    c = c * z + 2.08757008419747316778e-9;
    c = c * z - 2.75573141792967388112e-7;
    c = c * z + 2.48015872888517045348e-5;
    c = c * z - 1.38888888888730564116e-3;
    c = c * z + 4.16666666666665929218e-2;
    c = 1.0 - 0.5 * z + z * z * c;
    Whole odd = (quadrant & 1) != 0;
    *sine = (Vector)((Whole)choose(odd, c, s) ^ ((quadrant & 2) << 62));
    *cosine = (Vector)((Whole)choose(odd, s, c) ^ (((quadrant + 1) & 2) << 62));
}

#define SHUFFLE __builtin_shufflevector
#define LOW(a, b) SHUFFLE(a, b, 0, 8, 2, 10, 4, 12, 6, 14)
#define HIGH(a, b) SHUFFLE(a, b, 1, 9, 3, 11, 5, 13, 7, 15)
#define PAIRS_LOW(a, b) SHUFFLE(a, b, 0, 1, 8, 9, 4, 5, 12, 13)
#define PAIRS_HIGH(a, b) SHUFFLE(a, b, 2, 3, 10, 11, 6, 7, 14, 15)
#define HALF_LOW(a, b) SHUFFLE(a, b, 0, 1, 2, 3, 8, 9, 10, 11)
#define HALF_HIGH(a, b) SHUFFLE(a, b, 4, 5, 6, 7, 12, 13, 14, 15)

/* Number j of the rows of eight flights, in out[j]. A gather for each of the eight numbers
   would take several times as long. */
INLINE void look_up(const Row *table, Whole at, Vector *out) {
    Row r0 = table[at[0]], r1 = table[at[1]], r2 = table[at[2]], r3 = table[at[3]];
    Row r4 = table[at[4]], r5 = table[at[5]], r6 = table[at[6]], r7 = table[at[7]];
    Vector a0 = LOW(r0, r1), a1 = HIGH(r0, r1), a2 = LOW(r2, r3), a3 = HIGH(r2, r3);
    Vector a4 = LOW(r4, r5), a5 = HIGH(r4, r5), a6 = LOW(r6, r7), a7 = HIGH(r6, r7);
    /* aN hold flights 0 1 | 0 1 | 0 1 | 0 1 of numbers 0, 2, 4, 6 or 1, 3, 5, 7. */
    Vector b0 = PAIRS_LOW(a0, a2), b2 = PAIRS_HIGH(a0, a2);
    Vector b1 = PAIRS_LOW(a1, a3), b3 = PAIRS_HIGH(a1, a3);
    Vector b4 = PAIRS_LOW(a4, a6), b6 = PAIRS_HIGH(a4, a6);
    Vector b5 = PAIRS_LOW(a5, a7), b7 = PAIRS_HIGH(a5, a7);
    out[0] = HALF_LOW(b0, b4), out[4] = HALF_HIGH(b0, b4);
    out[1] = HALF_LOW(b1, b5), out[5] = HALF_HIGH(b1, b5);
    out[2] = HALF_LOW(b2, b6), out[6] = HALF_HIGH(b2, b6);
    out[3] = HALF_LOW(b3, b7), out[7] = HALF_HIGH(b3, b7);
}

/* Time derivative of eight flights: `comparators.rates`, line by line, and in SPACE what is
   about it. */
INLINE State rates(State y, Vector lift_factor, Vector drag_factor, const Plan *p,
                   const Row *table) {
    Vector velocity = y.velocity, sin, cos;
    sine_cosine(y.path, &sin, &cos);
    Vector radius = p->planet_radius + y.altitude;
    Vector per_both = 1.0 / (radius * velocity);
    Vector per_radius = velocity * per_both, per_velocity = radius * per_both;
    Vector square = velocity * velocity;
    Vector attraction = p->gravitational_parameter * per_radius;
    Vector gravity = attraction * per_radius;
    Vector pressure = exponential(-y.altitude * p->per_scale_height) * square;
    Vector drag = drag_factor * pressure, lift = lift_factor * pressure;

    /* The reference drag and its two derivatives over energy. */
    Vector position = (0.5 * square - attraction - p->reference_start) * p->per_spacing;
    Vector inside = least(greatest(position, same(0.0)), same(p->intervals));
    Vector interval = least(root(inside * p->intervals), same(p->intervals - 1.0));
    Vector c[8];
    look_up(table, __builtin_convertvector(interval, Whole), c);
    Vector per_width = c[6], x = inside * per_width - c[7];
    Vector wanted = ((((c[0] * x + c[1]) * x + c[2]) * x + c[3]) * x + c[4]) * x + c[5];
    Vector first =
        (((5.0 * c[0] * x + 4.0 * c[1]) * x + 3.0 * c[2]) * x + 2.0 * c[3]) * x + c[4];
    Vector second = ((20.0 * c[0] * x + 12.0 * c[1]) * x + 6.0 * c[2]) * x + 2.0 * c[3];
    Vector beyond = (position - inside) * per_width;
    wanted += beyond * (first + 0.5 * beyond * second);
    Vector per_unit = p->per_spacing * per_width;
    first = (first + beyond * second) * per_unit;
    second *= per_unit * per_unit;

    /* Drag dynamics as modelled on board: drag'' = f + g0 u. */
    Vector gravity_along = gravity * sin;
    Vector common =
        -velocity * sin * p->per_scale_height - 2.0 * gravity_along * per_velocity;
    Vector slowing = 2.0 * drag * per_velocity;
    Vector drag_rate = drag * (common - slowing);
    Vector sin2 = sin * sin, cos2 = cos * cos;
    Vector turning =
        drag * drag + 2.0 * drag * gravity_along + gravity * gravity * (sin2 - cos2);
    Vector f = (common - 2.0 * slowing) * drag_rate +
               drag * ((drag * sin + gravity) * p->per_scale_height +
                       (gravity * (4.0 * sin2 - 2.0 * cos2) -
                        square * cos2 * p->per_scale_height) *
                           per_radius -
                       2.0 * turning * per_velocity * per_velocity);
    Vector g0 = -(velocity * p->per_scale_height + 2.0 * gravity * per_velocity) *
                (p->lift_to_drag * drag * drag) * (cos * per_velocity);

    /* The law, and the observer that it is fed by. */
    Vector energy_rate = -drag * velocity;
    Vector energy_drift = -drag_rate * velocity + drag * (drag + gravity_along);
    Vector wanted_acceleration =
        second * energy_rate * energy_rate + first * energy_drift;
    Vector x1 = drag - wanted;
    Vector feedback = -p->feedback_error * x1 - p->feedback_rate * y.error_rate;
    Vector u = (wanted_acceleration - f + feedback) / g0;
    u = least(greatest(u, same(-1.0)), same(1.0));
    Vector innovation = x1 - y.error;

    Vector turn = velocity * cos * per_radius;
#ifdef SPACE
    Vector sin_turned, cos_turned, sin_latitude, cos_latitude;
    sine_cosine(y.turned, &sin_turned, &cos_turned);
    sine_cosine(y.latitude, &sin_latitude, &cos_latitude);
    Vector per_cosines = 1.0 / (cos * cos_latitude);
    Vector eastward = turn * cos_turned * (per_cosines * cos);
    Vector sideways = lift * root(1.0 - u * u) * per_velocity;
#endif
    return (State){
        .altitude = velocity * sin,
#ifdef SPACE
        .downrange = eastward, /* the longitude */
        .latitude = -turn * sin_turned,
        .turned = sideways * (per_cosines * cos_latitude) + eastward * sin_latitude,
#else
        .downrange = turn,
#endif
        .velocity = -drag - gravity_along,
        .path = (lift * u - gravity * cos) * per_velocity + turn,
        .error = y.error_rate + p->innovation_error * innovation,
        .error_rate = feedback + p->innovation_rate * innovation,
    };
}

/* y + step * k */
INLINE State moved(State y, Vector step, State k) {
    y.altitude += step * k.altitude;
    y.downrange += step * k.downrange;
    y.velocity += step * k.velocity;
    y.path += step * k.path;
    y.error += step * k.error;
    y.error_rate += step * k.error_rate;
#ifdef SPACE
    y.latitude += step * k.latitude;
    y.turned += step * k.turned;
#endif
    return y;
}

/* One step of the classical Runge-Kutta method. */
INLINE State advanced(State y, Vector lift, Vector drag, Vector step, const Plan *p,
                      const Row *table) {
    Vector half = 0.5 * step, sixth = step * (1.0 / 6.0), third = step * (1.0 / 3.0);
    State k = rates(y, lift, drag, p, table), sum = moved(y, sixth, k);
    k = rates(moved(y, half, k), lift, drag, p, table), sum = moved(sum, third, k);
    k = rates(moved(y, half, k), lift, drag, p, table), sum = moved(sum, third, k);
    k = rates(moved(y, step, k), lift, drag, p, table);
    return moved(sum, sixth, k);
}

/* Positive until the first of the two conditions ends the flight. */
INLINE Vector margin_of(State y, const Mission *m) {
    return least(y.velocity - m->end_velocity, y.altitude - m->end_altitude);
}

/* Eight flights on their way. */
typedef struct {
    State y;
    Vector lift, drag, time, margin;
    Vector flight; /* its number, or -1 for one that fills a place only */
} Group;

#define FIELDS (sizeof(Group) / sizeof(Vector))

/* What all threads share. */
typedef struct {
    const Mission *m;
    const Plan *p;
    const Row *table;
    const double *lift, *drag;
    double step, *out;
    long count;
    atomic_long next;
} Work;

static void put(Group *to, int place, const Group *from, int lane) {
    for (unsigned i = 0; i < FIELDS; i++)
        ((Vector *)to)[i][place] = ((const Vector *)from)[i][lane];
}

/* Put the next flight into a place. Returns whether there was one; if not, the first flight
   fills the place. */
static int begin(Group *group, int place, Work *work) {
    const Mission *m = work->m;
    long flight = atomic_fetch_add(&work->next, 1);
    int there = flight < work->count;
    Group new = {
        .y.altitude = same(m->altitude),
        .y.velocity = same(m->velocity),
        .y.path = same(m->flight_path_angle),
        .lift = same(work->lift[there ? flight : 0]),
        .drag = same(work->drag[there ? flight : 0]),
        .flight = same(there ? flight : -1),
    };
    /* With estimates of zero the first estimate grows by the innovation alone. */
    State rate = rates(new.y, new.lift, new.drag, work->p, work->table);
    new.y.error = rate.error / work->p->innovation_error;
    new.margin = margin_of(new.y, m);
    put(group, place, &new, 0);
    return there;
}

/* The end lies within one step from here: shorten it by the rule of false position, with the
   margin of an end halved that stays (Illinois). Those out of time end where they are. */
static void end(const Group *group, int places, Work *work) {
    const Mission *m = work->m;
    Vector low = {0}, high = same(work->step), trial = {0};
    Vector at_low = group->margin;
    State y = advanced(group->y, group->lift, group->drag, high, work->p, work->table);
    Vector at_high = margin_of(y, m);
    Whole searched = (at_high <= 0.0) & (group->time < m->time_limit), side = {0};
    for (int i = 0; i < 30; i++) {
        Vector between = low + (high - low) * (at_low / (at_low - at_high));
        trial = choose(searched, between, trial);
        y = advanced(group->y, group->lift, group->drag, trial, work->p, work->table);
        Vector after = margin_of(y, m);
        searched &= (after >= 1e-7) | (after <= -1e-7);
        int left = 0;
        for (int lane = 0; lane < places; lane++) left |= searched[lane] != 0;
        if (!left) break;
        Whole early = after > 0.0;
        at_high = choose(early, choose(side > 0, 0.5 * at_high, at_high), after);
        at_low = choose(early, after, choose(side < 0, 0.5 * at_low, at_low));
        low = choose(early, trial, low);
        high = choose(early, high, trial);
        side = ~early | 1;
    }
    for (int lane = 0; lane < places; lane++) {
        double *out = work->out + (long)group->flight[lane];
        out[0] = group->time[lane] + trial[lane];
        out[work->count] = y.altitude[lane];
        out[2 * work->count] = y.downrange[lane] * m->planet_radius;
        out[3 * work->count] = y.velocity[lane];
    }
}

static void *fly(void *given) {
    Work *work = given;
    const Mission *m = work->m;
    Group group, ended;
    int flying = 0, places = 0;
    for (int lane = 0; lane < LANES; lane++) flying += begin(&group, lane, work);
    ended = group; /* numbers, in the places that stay empty */
    while (flying) {
        State y = advanced(group.y, group.lift, group.drag, same(work->step), work->p,
                           work->table);
        Vector margin = margin_of(y, m);
        Whole over = (margin <= 0.0) | (group.time >= m->time_limit);
        for (int lane = 0; lane < LANES; lane++) {
            if (!over[lane] || group.flight[lane] < 0) continue;
            put(&ended, places++, &group, lane);
            if (places == LANES) end(&ended, places, work), places = 0;
        }
        Group before = group;
        group.y = y, group.margin = margin, group.time += work->step;
        for (int lane = 0; lane < LANES; lane++)
            if (over[lane]) flying += begin(&group, lane, work) - (before.flight[lane] >= 0);
    }
    if (places) end(&ended, places, work);
    return 0;
}

/* Fly `count` flights; `out` takes time, altitude, downrange and velocity at their ends, one
   row of `count` numbers for each. `rows`: eight numbers for each interval, aligned to 64
   bytes. Returns 0, or 1 where there are no more threads. */
int fly_all(const double *mission, const double *plan, const double *rows,
            const double *lift, const double *drag, long count, double step, int threads,
            double *out) {
    Work work = {.m = (const Mission *)mission, .p = (const Plan *)plan,
                 .table = (const Row *)rows, .lift = lift, .drag = drag,
                 .step = step, .out = out, .count = count};
    pthread_t others[MAX_THREADS];
    int started = 0;
    if (threads > MAX_THREADS) return 1;
    while (started < threads - 1 && !pthread_create(&others[started], 0, fly, &work))
        started++;
    fly(&work);
    for (int i = 0; i < started; i++) pthread_join(others[i], 0);
    return started < threads - 1;
}
