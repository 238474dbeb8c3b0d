// The forward Euler step of Nalbach 2017, 8.5. The host refuses (a + kr) dt > 1, where it would overshoot.

vec4 step_state(vec4 r, vec4 a, vec4 kr, float dt) {
    return r + dt * ((1.0 - r) * a - kr * r);
}
