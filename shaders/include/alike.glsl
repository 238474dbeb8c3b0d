// How much a neighbour's light is that of a receiver: 1 on one flat surface, 0 across an edge.
const float SHARPNESS = 32.0; // the power of the normals' cosine
const float STEEPEST = 0.1;   // the slope out of the receiver's plane at which nothing is left

float alike(vec3 p, vec3 n, vec3 q, vec3 m) {
    vec3 to = q - p;
    float off = abs(dot(n, to)) / max(STEEPEST * length(to), 1e-30);
    return pow(max(dot(n, m), 0.0), SHARPNESS) * max(1.0 - off, 0.0);
}

// Light changes over as short a way as the surroundings are far (Ward, Rubinstein and Clear 1988): at this
// share of their harmonic mean distance half of the weight is left, and at one and a half times as far none.
const float NEAR = 0.15;

float near_enough(vec3 p, vec3 q, float surroundings) {
    return clamp(1.5 - distance(p, q) / (NEAR * surroundings), 0.0, 1.0);
}
