// Forward Euler in as many equal parts as the texel's own stability asks for; each takes the light at its start.
// The host refuses what would take too many.

void step_state(STATE r, STATE kr_dt, Drive drive, out STATE from, out STATE change) {
    int n = max(1, int(ceil(stiffness(drive, kr_dt))));
    float part = 1.0 / float(n);
    from = r;
    change = STATE(0.0); // summed by itself: it is small, and keeps more of its bits
    for (int m = 0; m < n; ++m) {
        STATE x = r + change;
        change += part * ((1.0 - x) * excitation_at(drive, float(m) * part) - kr_dt * x);
    }
    change = keep_inside(r, change);
}
