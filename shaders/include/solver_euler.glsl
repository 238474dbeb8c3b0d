// The forward Euler step of Nalbach 2017, 8.5. The host refuses (a + kr) dt > 1, where it would overshoot.

void step_state(STATE r, STATE kr_dt, Drive drive, out STATE from, out STATE change) {
    from = r;
    change = keep_inside(r, (1.0 - r) * drive.a0 - kr_dt * r);
}
