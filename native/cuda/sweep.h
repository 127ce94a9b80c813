// A LiDAR's sweep on the device: the rays of its beams, and what these measure.
//
// `core/sensors/lidar.py` is the specification of the rays, and `core/model/decode.py` of the returns. Every function does
// the work of one thread.
#pragma once
#include "image.h"

namespace {

// The beam table of a sweep, whose rays are numbered row by row: `beams` rows and `columns`.
struct SweepInputs {
    int32_t beams, columns, keys;
    const double *elevation, *azimuth_offset; // (beams), radians
    const double *delay;                      // (beams), seconds after the column's time
    const double *azimuth, *time;             // (columns), radians and seconds
    const double *key_times, *positions, *quaternions; // (keys, ...): the sensor's trajectory, as of an actor
    double *origins, *directions, *times;     // the same arrays as of `TraceInputs`
};

// The ray of a beam, from where the sensor is when it is fired.
UNISIM_DEVICE inline void begin_beam(const SweepInputs &sweep, int64_t ray) {
    const int64_t beam = ray / sweep.columns, column = ray % sweep.columns;
    const double time = sweep.time[column] + sweep.delay[beam];
    const double azimuth = sweep.azimuth[column] + sweep.azimuth_offset[beam], elevation = sweep.elevation[beam];
    const double cosine = std::cos(elevation);
    const double local[3] = {cosine * std::cos(azimuth), cosine * std::sin(azimuth), std::sin(elevation)};
    unisim_actor_set sensor{};
    sensor.keys = sweep.keys;
    sensor.lengths = &sensor.keys;
    sensor.times = sweep.key_times;
    sensor.positions = sweep.positions;
    sensor.quaternions = sweep.quaternions;
    const KeyInterval at = key_interval(sensor, 0, time);
    double rotation[9];
    position_at(sensor, 0, at, sweep.origins + 3 * ray);
    rotation_at(sensor, 0, at, rotation);
    for (int a = 0; a < 3; ++a)
        sweep.directions[3 * ray + a] =
            rotation[3 * a] * local[0] + rotation[3 * a + 1] * local[1] + rotation[3 * a + 2] * local[2];
    sweep.times[ray] = time;
}

// The intensity of a beam's return and its probability; with `range`, its depth, 0 where it hits nothing.
UNISIM_DEVICE inline void decode_beam(const TraceInputs &in, const unisim_head &head, int64_t ray, float *intensity,
                                      float *probability, float *range) {
    float x[MAX_WIDTH], active[MAX_WIDTH];
    const float extra[2] = {std::log1p(in.result.depth[ray]) / 5.0f, in.result.opacity[ray]};
    run_head(head, in.result.feature + ray * head.features, in.rays.directions + 3 * ray, extra, x, active);
    const bool solid = in.result.opacity[ray] > 0.5f;
    intensity[ray] = sigmoid(x[0]);
    probability[ray] = solid ? sigmoid(x[1]) : 0.0f;
    if (range) range[ray] = solid && in.result.median[ray] < HUGE_VALF ? in.result.median[ray] : 0.0f;
}

} // namespace
