// The excitation over one step, times dt, as the quadratic a(s) = a0 + a1 s + a2 s² in the share s of the step.
struct Drive {
    STATE a0, a1, a2;
};

STATE excitation_at(Drive drive, float s) {
    // A quadratic through what is never negative may dip below 0 in between.
    return max(drive.a0 + s * (drive.a1 + s * drive.a2), 0.0);
}

// The largest (a + kr) dt of start, middle and end, over the states.
float stiffness(Drive drive, STATE kr_dt) {
    STATE a = max(drive.a0, max(excitation_at(drive, 0.5), excitation_at(drive, 1.0)));
    STATE k = a + kr_dt;
#if STATES <= 2
    return max(k.x, k.y);
#else
    return max(max(k.x, k.y), max(k.z, k.w));
#endif
}

// `change`, cut so that r + change, as it rounds, stays in [0, 1]. For solvers that rounding or a tolerance may put
// outside.
STATE keep_inside(STATE r, STATE change) {
    return clamp(change, -r, 1.0 - r);
}
