// The exact step where x = (a + kr) dt <= 1/8, as it is from one display frame to the next: no exponential, no choice.
//     r' - r = (a dt - x r) phi(x),  phi(x) = (1 - exp(-x)) / x
// phi is a polynomial of degree 3, 1 at 0 and minimax up to 1/8: its relative error of 2e-8 is a third of half a unit
// in the last place. Beside the equilibrium, a dt - x r errs by no more than 1/8 of half a unit in the last place of r,
// since a dt <= r_inf / 8: what that adds is rounded away, so no step passes the equilibrium.

void step_state(STATE r, STATE kr_dt, Drive drive, out STATE from, out STATE change) {
    STATE x = drive.a0 + kr_dt;
    from = r;
    change = (drive.a0 - x * r) * (1.0 + x * (-0.49999711 + x * (0.16652605 + x * -0.03971588)));
}
