// The exact step under constant excitation (solution of Nalbach 2017, eq. 8.1):
//     x = (a + kr) dt,  r_inf = a dt / x,  r' = r_inf + (r - r_inf) exp(-x)
#include "exponential.glsl"

void step_state(STATE r, STATE kr_dt, Drive drive, out STATE from, out STATE change) {
    STATE x = drive.a0 + kr_dt;
    STATE r_inf = at_most(drive.a0 / x, 1.0); // the host keeps kr dt above 0
    STATE p, s, n;
    exp_minus(x, p, s, n);
    // A short step adds an increment to r, which so keeps its last bits. A long one starts from the equilibrium:
    // there exp(-x) = p - p s <= 0.71, and nothing cancels. Either way the factor is below 0.71, so the sum lies between
    // r and r_inf before it is rounded, and, rounding being monotone, after: no step passes the equilibrium.
    STATE_BOOL is_short = equal(n, STATE(0.0));
    from = mix(r_inf, r, is_short);
    change = (r - r_inf) * (mix(p, STATE(0.0), is_short) - p * s);
}
