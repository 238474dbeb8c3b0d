// Adaptive Runge-Kutta of order 2(3) (Bogacki and Shampine 1989), with steps of each texel's own.
// The host refuses what would take too many.

const float RTOL = 1e-3, ATOL = 1e-6; // as phoslab.solvers
// The shortest part, as a share of the step: stable for whatever the host lets through, so it is always accepted.
const float SHORTEST = 1.0 / EXPLICIT_LIMIT;
const int MOST_PARTS = 4 * int(EXPLICIT_LIMIT); // accepted or not; never reached, but a loop must end

STATE slope(STATE x, STATE kr_dt, Drive drive, float s) {
    return (1.0 - x) * excitation_at(drive, s) - kr_dt * x;
}

void step_state(STATE r, STATE kr_dt, Drive drive, out STATE from, out STATE change) {
    from = r;
    change = STATE(0.0);
    // Half of 1 / k at first: the estimated error goes with (k h)² (1 - k h), and is blind where k h = 1.
    float s = 0.0, h = 0.5 / max(stiffness(drive, kr_dt), 0.5);
    STATE k1 = slope(r, kr_dt, drive, 0.0);
    for (int part = 0; s < 1.0 && part < MOST_PARTS; ++part) {
        h = min(max(h, SHORTEST), 1.0 - s);
        STATE x = r + change;
        STATE k2 = slope(x + h * 0.5 * k1, kr_dt, drive, s + 0.5 * h);
        STATE k3 = slope(x + h * 0.75 * k2, kr_dt, drive, s + 0.75 * h);
        STATE more = h * (2.0 / 9.0 * k1 + 1.0 / 3.0 * k2 + 4.0 / 9.0 * k3);
        STATE k4 = slope(x + more, kr_dt, drive, s + h);
        STATE error = h * (5.0 / 72.0 * k1 - 1.0 / 12.0 * k2 - 1.0 / 9.0 * k3 + 1.0 / 8.0 * k4);
        error /= ATOL + RTOL * max(abs(x), abs(x + more));
        float norm = sqrt(dot(error, error) / float(STATES));
        if (norm <= 1.0 || h <= SHORTEST) {
            change += more;
            // The last part ends at 1 whatever s + h rounds to.
            s = h >= 1.0 - s ? 1.0 : s + h;
            k1 = k4;
        }
        h *= clamp(0.9 * pow(max(norm, 1e-6), -1.0 / 3.0), 0.2, norm <= 1.0 ? 10.0 : 0.9);
    }
    change = keep_inside(r, change);
}
