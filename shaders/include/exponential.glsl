// exp(-x) for x >= 0 to a few units in the last place, whatever the driver's exp() is worth, and 1 - exp(-x) for
// small x, where nothing may cancel.
//
// x = n ln 2 + f with |f| <= ln 2 / 2, so exp(-x) = 2^-n (1 - s) with s = 1 - exp(-f). Where n = 0, s is 1 - exp(-x).
// s / f is a polynomial of degree 5, minimax on that interval: its relative error of 1.7e-8 is 0.3 of half a unit in
// the last place. (The Taylor series needs one term more for as much.)
//
// STATE is the vector type that holds one value a state.

const float X_MAX = 87.0; // exp(-87) is the smallest power that is still a normal float32

// e = exp(-x); s = 1 - exp(-x) where n = 0. x must not exceed X_MAX.
void exp_minus(STATE x, out STATE e, out STATE s, out STATE n) {
    n = roundEven(x * 1.44269504);
    STATE f = (x - n * 0.693359375) + n * 2.12194440e-4; // ln 2 in two parts, the first with few bits
    s = f + f * f * (-0.49999997 + f * (0.166665435 + f * (-0.0416672006
          + f * (0.00836652052 + f * -0.00138825213))));
    STATE power = intBitsToFloat((127 - STATE_INT(n)) << 23); // 2^-n
    e = power - power * s;
}
