// exp(-x) for x >= 0 to a few units in the last place, whatever the driver's exp() is worth, and 1 - exp(-x) for
// small x, where nothing may cancel.
//
// x = n ln 2 + f with |f| <= ln 2 / 2, so exp(-x) = p - p s with p = 2^-n and s = 1 - exp(-f). Where n = 0, s is
// 1 - exp(-x). s / f is a polynomial of degree 5, minimax on that interval: its relative error of 1.7e-8 is 0.3 of half
// a unit in the last place. (The Taylor series needs one term more for as much.) It is summed in pairs, which takes
// less time than one after the other.
//
// STATE is the vector type that holds one value a state.

// min(v, limit) for v >= 0, NaN apart. Positive floats are ordered as integers are, and of these none is NaN: what
// min() does for the sake of NaN costs more than the comparison.
STATE at_most(STATE v, float limit) {
    return intBitsToFloat(min(floatBitsToInt(v), STATE_INT(floatBitsToInt(limit))));
}

// p, s and n as above. exp(-87) is the smallest power that is still a normal float32; beyond, it stays at that.
void exp_minus(STATE x, out STATE p, out STATE s, out STATE n) {
    x = at_most(x, 87.0);
    // 1.5 * 2^23 pushes the fraction out: the sum's last bits are the nearest integer, in two's complement.
    precise STATE shifted = x * 1.44269504 + 12582912.0;
    precise STATE nearest = shifted - 12582912.0;
    n = nearest;
    STATE f = (x - n * 0.693359375) + n * 2.12194440e-4; // ln 2 in two parts, the first with few bits
    STATE f2 = f * f;
    s = f + f2 * ((-0.49999997 + f * 0.166665435)
                  + f2 * ((-0.0416672006 + f * 0.00836652052) + f2 * -0.00138825213));
    p = intBitsToFloat((127 << 23) - (floatBitsToInt(shifted) << 23));
}
