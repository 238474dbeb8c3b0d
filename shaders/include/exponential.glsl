// exp(-x) and 1 - exp(-x) for x >= 0, to a few units in the last place whatever the driver's exp() is worth.
//
// x = n ln 2 + f with |f| <= ln 2 / 2, so exp(-x) = 2^-n exp(-f). The series of 1 - exp(-f) ends at f^7 / 7!; what is
// left is below 0.35^7 / 8! = 1.6e-8 of it, a quarter of a unit in the last place. For n = 0 it is 1 - exp(-x) itself
// and nothing cancels: that is what keeps the small increments of a slow material.

const float X_MAX = 87.0; // exp(-87) is the smallest power that is still a normal float32

vec4 series_one_minus_exp(vec4 f) {
    vec4 s = 1.0 - f * (1.0 / 7.0);
    s = 1.0 - f * (1.0 / 6.0) * s;
    s = 1.0 - f * (1.0 / 5.0) * s;
    s = 1.0 - f * (1.0 / 4.0) * s;
    s = 1.0 - f * (1.0 / 3.0) * s;
    s = 1.0 - f * (1.0 / 2.0) * s;
    return f * s;
}

// e = exp(-x), g = 1 - exp(-x); x must not exceed X_MAX.
void exp_minus(vec4 x, out vec4 e, out vec4 g) {
    vec4 n = floor(x * 1.44269504 + 0.5);
    vec4 f = (x - n * 0.693359375) + n * 2.12194440e-4; // ln 2 in two parts, the first with few bits
    vec4 s = series_one_minus_exp(f);
    e = ldexp(1.0 - s, -ivec4(n));
    g = mix(1.0 - e, s, equal(n, vec4(0.0)));
}
