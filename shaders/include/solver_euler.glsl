// The forward Euler step of Nalbach 2017, 8.5. The host refuses (a + kr) dt > 1, where it would overshoot.

STATE step_state(STATE r, STATE a, STATE kr, float dt) {
    return r + dt * ((1.0 - r) * a - kr * r);
}
