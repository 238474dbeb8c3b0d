// The difference of two pixels' light, in standard deviations, from which on they count as less alike, and from twice
// which on not at all: below, a filter leaves noise; above, it carries light over shadows' edges.
const float SIGNIFICANT = 1.5;

// Less of a neighbour whose light differs by more than their noise does.
float same_light(vec2 a, vec2 b) {
    // The last terms are the rounding of sums, and keep what is nothing at all from being divided by nothing.
    float off = a.x - b.x, noise = a.y + b.y + 1e-6 * a.x * a.x + 1e-24;
    return clamp(2.0 - sqrt(off * off / noise) / SIGNIFICANT, 0.0, 1.0);
}
