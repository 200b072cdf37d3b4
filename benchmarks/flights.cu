/* The guided Mars entry of `comparators.py` in CUDA, one thread a flight.

   The equations of `comparators.rates` on scalars, so that a flight stays in registers. It
   takes the steps of `flights.c` and ends by the same rule. It computes no peaks of path
   constraints and checks nothing. `gpu.py` compiles it; `fly_host` flies on the processor,
   which shows without a GPU that the program is right. */

#include <cuda_runtime.h>

#define BOTH __host__ __device__ __forceinline__

/* In the order of `comparators.Mission` and `comparators.Plan`. */
struct Mission {
    double planet_radius, gravitational_parameter, surface_density, scale_height;
    double reference_area, lift_coefficient, drag_coefficient;
    double altitude, velocity, flight_path_angle;
    double end_velocity, end_altitude, time_limit;
    double epsilon0, a, b, epsilon, l1, l2, reference_start, reference_spacing;
};

struct Plan {
    double planet_radius, gravitational_parameter, per_scale_height, lift_to_drag;
    double feedback_error, feedback_rate, innovation_error, innovation_rate;
    double reference_start, per_spacing, intervals;
};

struct State { /* or its time derivative */
    double altitude, downrange, velocity, path, error, error_rate;
};

/* What the flights share. `table` has eight numbers for each interval of the reference. */
struct Shared {
    Mission m;
    Plan p;
    const double *table;
    double step;
};

BOTH double least(double x, double y) { return x < y ? x : y; }
BOTH double greatest(double x, double y) { return x > y ? x : y; }

/* Time derivative: `comparators.rates`, line by line. */
BOTH State rates(const State &y, double lift_factor, double drag_factor, const Shared &s) {
    const Plan &p = s.p;
    double velocity = y.velocity, sine, cosine;
    sincos(y.path, &sine, &cosine);
    double radius = p.planet_radius + y.altitude;
    double per_both = 1.0 / (radius * velocity);
    double per_radius = velocity * per_both, per_velocity = radius * per_both;
    double square = velocity * velocity;
    double attraction = p.gravitational_parameter * per_radius;
    double gravity = attraction * per_radius;
    double pressure = exp(-y.altitude * p.per_scale_height) * square;
    double drag = drag_factor * pressure, lift = lift_factor * pressure;

    double position = (0.5 * square - attraction - p.reference_start) * p.per_spacing;
    double inside = least(greatest(position, 0.0), p.intervals);
    int interval = (int)least(sqrt(inside * p.intervals), p.intervals - 1.0);
    const double *c = s.table + 8 * interval;
    double per_width = c[6], x = inside * per_width - c[7];
    double wanted = ((((c[0] * x + c[1]) * x + c[2]) * x + c[3]) * x + c[4]) * x + c[5];
    double first =
        (((5.0 * c[0] * x + 4.0 * c[1]) * x + 3.0 * c[2]) * x + 2.0 * c[3]) * x + c[4];
    double second = ((20.0 * c[0] * x + 12.0 * c[1]) * x + 6.0 * c[2]) * x + 2.0 * c[3];
    double beyond = (position - inside) * per_width;
    wanted += beyond * (first + 0.5 * beyond * second);
    double per_unit = p.per_spacing * per_width;
    first = (first + beyond * second) * per_unit;
    second *= per_unit * per_unit;

    /* Drag dynamics as modelled on board: drag'' = f + g0 u. */
    double along = gravity * sine;
    double common = -velocity * sine * p.per_scale_height - 2.0 * along * per_velocity;
    double slowing = 2.0 * drag * per_velocity;
    double drag_rate = drag * (common - slowing);
    double sine2 = sine * sine, cosine2 = cosine * cosine;
    double turning =
        drag * drag + 2.0 * drag * along + gravity * gravity * (sine2 - cosine2);
    double curving = gravity * (4.0 * sine2 - 2.0 * cosine2);
    curving = (curving - square * cosine2 * p.per_scale_height) * per_radius;
    double f = (common - 2.0 * slowing) * drag_rate +
               drag * ((drag * sine + gravity) * p.per_scale_height + curving -
                       2.0 * turning * per_velocity * per_velocity);
    double g0 = -(velocity * p.per_scale_height + 2.0 * gravity * per_velocity) *
                (p.lift_to_drag * drag * drag) * (cosine * per_velocity);

    /* The law, and the observer that it is fed by. */
    double energy_rate = -drag * velocity;
    double energy_drift = -drag_rate * velocity + drag * (drag + along);
    double x1 = drag - wanted;
    double feedback = -p.feedback_error * x1 - p.feedback_rate * y.error_rate;
    double u = second * energy_rate * energy_rate + first * energy_drift - f + feedback;
    u = least(greatest(u / g0, -1.0), 1.0);
    double innovation = x1 - y.error;

    double turn = velocity * cosine * per_radius;
    return {velocity * sine,
            turn,
            -drag - along,
            (lift * u - gravity * cosine) * per_velocity + turn,
            y.error_rate + p.innovation_error * innovation,
            feedback + p.innovation_rate * innovation};
}

/* y + step * k */
BOTH State moved(State y, double step, const State &k) {
    y.altitude += step * k.altitude;
    y.downrange += step * k.downrange;
    y.velocity += step * k.velocity;
    y.path += step * k.path;
    y.error += step * k.error;
    y.error_rate += step * k.error_rate;
    return y;
}

/* One step of the classical Runge-Kutta method. */
BOTH State advanced(const State &y, double lift, double drag, double step, const Shared &s) {
    State k = rates(y, lift, drag, s), sum = moved(y, step / 6.0, k);
    k = rates(moved(y, 0.5 * step, k), lift, drag, s), sum = moved(sum, step / 3.0, k);
    k = rates(moved(y, 0.5 * step, k), lift, drag, s), sum = moved(sum, step / 3.0, k);
    k = rates(moved(y, step, k), lift, drag, s);
    return moved(sum, step / 6.0, k);
}

/* Positive until the first of the two conditions ends the flight. */
BOTH double margin_of(const State &y, const Mission &m) {
    return least(y.velocity - m.end_velocity, y.altitude - m.end_altitude);
}

BOTH void fly(const Shared &s, double lift, double drag, long flight, long count,
              double *out) {
    const Mission &m = s.m;
    State y = {m.altitude, 0.0, m.velocity, m.flight_path_angle, 0.0, 0.0};
    /* With estimates of zero the first estimate grows by the innovation alone. */
    y.error = rates(y, lift, drag, s).error / s.p.innovation_error;
    double time = 0.0, margin = margin_of(y, m), after = margin;
    State next = y;
    while (time < m.time_limit) {
        next = advanced(y, lift, drag, s.step, s);
        after = margin_of(next, m);
        if (after <= 0.0) break;
        y = next, margin = after, time += s.step;
    }
    /* False position, with the margin of an end halved that stays (Illinois). */
    double low = 0.0, at_low = margin, high = s.step, at_high = after, trial = 0.0;
    int side = 0;
    for (int i = 0; i < 30 && at_high <= 0.0; i++) {
        trial = low + (high - low) * (at_low / (at_low - at_high));
        next = advanced(y, lift, drag, trial, s);
        after = margin_of(next, m);
        if (after < 1e-7 && after > -1e-7) break;
        if (after > 0.0) {
            if (side > 0) at_high *= 0.5;
            low = trial, at_low = after, side = 1;
        } else {
            if (side < 0) at_low *= 0.5;
            high = trial, at_high = after, side = -1;
        }
    }
    out[flight] = time + trial;
    out[count + flight] = next.altitude;
    out[2 * count + flight] = next.downrange * m.planet_radius;
    out[3 * count + flight] = next.velocity;
}

__global__ void fly_each(Shared s, const double *lift, const double *drag, long count,
                         double *out) {
    long flight = blockIdx.x * (long)blockDim.x + threadIdx.x;
    if (flight < count) fly(s, lift[flight], drag[flight], flight, count, out);
}

static Shared shared(const double *mission, const double *plan, const double *table,
                     double step) {
    return {*(const Mission *)mission, *(const Plan *)plan, table, step};
}

/* As `fly_all` of `flights.c`, on the processor. */
extern "C" int fly_host(const double *mission, const double *plan, const double *rows,
                        const double *lift, const double *drag, long count, double step,
                        double *out) {
    Shared s = shared(mission, plan, rows, step);
    for (long i = 0; i < count; i++) fly(s, lift[i], drag[i], i, count, out);
    return 0;
}

/* On the GPU, in blocks of `block` threads. `seconds` takes the time of the kernel, the
   least of three calls. Returns 0, or the error of CUDA. */
extern "C" int fly_gpu(const double *mission, const double *plan, const double *rows,
                       long intervals, const double *lift, const double *drag, long count,
                       double step, int block, double *out, double *seconds) {
    double *table, *inputs, *ends;
    size_t row = 8 * sizeof(double) * intervals, column = sizeof(double) * count;
    if (cudaMalloc(&table, row) || cudaMalloc(&inputs, 2 * column) ||
        cudaMalloc(&ends, 4 * column))
        return cudaGetLastError();
    cudaMemcpy(table, rows, row, cudaMemcpyHostToDevice);
    cudaMemcpy(inputs, lift, column, cudaMemcpyHostToDevice);
    cudaMemcpy(inputs + count, drag, column, cudaMemcpyHostToDevice);
    Shared s = shared(mission, plan, table, step);
    cudaEvent_t begin, end;
    cudaEventCreate(&begin);
    cudaEventCreate(&end);
    *seconds = 1e300;
    for (int call = 0; call < 4; call++) { /* the first one is not counted */
        float milliseconds = 0;
        cudaEventRecord(begin);
        fly_each<<<(count + block - 1) / block, block>>>(s, inputs, inputs + count, count,
                                                         ends);
        cudaEventRecord(end);
        cudaEventSynchronize(end);
        cudaEventElapsedTime(&milliseconds, begin, end);
        if (call > 0) *seconds = least(*seconds, 1e-3 * milliseconds);
    }
    cudaMemcpy(out, ends, 4 * column, cudaMemcpyDeviceToHost);
    cudaFree(table);
    cudaFree(inputs);
    cudaFree(ends);
    return cudaGetLastError();
}
