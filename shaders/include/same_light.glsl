// Standard deviations of the difference at which two pixels' light begins to count as different: below, a filter leaves
// noise; above, it carries light over shadows' edges. The sample scenes' error is least between 1 and 2.
const float SIGNIFICANT = 1.5;

// Less of a neighbour whose light differs by more than their noise does.
float same_light(vec2 a, vec2 b) {
    // The last terms are the rounding of sums, and keep what is nothing at all from being divided by nothing.
    float off = a.x - b.x, noise = SIGNIFICANT * SIGNIFICANT * (a.y + b.y) + 1e-6 * a.x * a.x + 1e-24;
    return exp(-0.5 * off * off / noise);
}
