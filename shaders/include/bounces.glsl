// Directions in which pixels look, and how they are kept: in a word each, as the unit octahedron unfolded.
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

// A hit is the surfel's number plus 1, and the level that found it in the highest bits; 0 is none.
const int LEVEL_BIT = 28;

uint surfel_of(uint hit) {
    return (hit & ((1u << LEVEL_BIT) - 1u)) - 1u;
}
