// The exact step under constant excitation (solution of Nalbach 2017, eq. 8.1):
//     k = a + kr,  r_inf = a / k,  r' = r_inf + (r - r_inf) exp(-k dt)
#include "exponential.glsl"

void step_state(STATE r, STATE kr, Drive drive, float dt, out STATE from, out STATE change) {
    STATE k = drive.a0 + kr;
    STATE r_inf = min(drive.a0 / k, 1.0); // the host keeps kr above 0
    STATE e, s, n;
    exp_minus(min(k * dt, X_MAX), e, s, n);
    // A short step adds an increment to r, which so keeps its last bits. A long one starts from the equilibrium:
    // there exp(-k dt) <= 0.71, and nothing cancels. Either way the factor is below 0.71, so the sum lies between r
    // and r_inf before it is rounded, and, rounding being monotone, after: no step passes the equilibrium.
    STATE_BOOL is_short = equal(n, STATE(0.0));
    from = mix(r_inf, r, is_short);
    change = (r - r_inf) * mix(e, -s, is_short);
}
