// Directions in which pixels look, and how they are kept: in a word each, as the unit octahedron unfolded.
layout(std430, binding = 5) readonly buffer Points { vec2 points[]; }; // of the unit square; DIRECTIONS a place

vec2 fold(vec2 v) {
    return (1.0 - abs(v.yx)) * vec2(v.x >= 0.0 ? 1.0 : -1.0, v.y >= 0.0 ? 1.0 : -1.0);
}

uint pack_direction(vec3 d) {
    d /= abs(d.x) + abs(d.y) + abs(d.z);
    return packSnorm2x16(d.z >= 0.0 ? d.xy : fold(d.xy));
}

vec3 unpack_direction(uint word) {
    vec2 v = unpackSnorm2x16(word);
    float z = 1.0 - abs(v.x) - abs(v.y);
    return normalize(vec3(z >= 0.0 ? v : fold(v), z));
}

// Direction `k` of a pixel whose surface has normal n: its density is that of BRDF times cosine, cos / π for Lambert.
uint choose_direction(ivec2 pixel, int k, vec3 n) {
    vec2 u = points[((pixel.y % PATTERN) * PATTERN + pixel.x % PATTERN) * DIRECTIONS + k];
    float angle = 6.28318531 * u.y, s = n.z >= 0.0 ? 1.0 : -1.0;
    // An orthonormal basis around n (Duff et al. 2017).
    float a = -1.0 / (s + n.z), b = n.x * n.y * a;
    vec3 x = vec3(1.0 + s * n.x * n.x * a, s * b, -s * n.x), y = vec3(b, s + n.y * n.y * a, -n.y);
    return pack_direction(sqrt(u.x) * (cos(angle) * x + sin(angle) * y) + sqrt(1.0 - u.x) * n);
}

// A hit is the surfel's number plus 1, and the level that found it in the highest bits; 0 is none.
const int LEVEL_BIT = 28;

uint surfel_of(uint hit) {
    return (hit & ((1u << LEVEL_BIT) - 1u)) - 1u;
}
