// How triangles become surfels: what the steps of `surfelize.comp.glsl` share.
#include "surfels.glsl"
#include "hash.glsl"

uniform vec3 eye;
uniform float per_distance; // a surfel's radius over its distance from the eye
uniform float nearest;      // the distance below which surfels shrink no more

// Fine surfels on each that is kept, and halvings of a triangle's sides at most.
const float FINE = 2.0;
const int MOST_HALVINGS = 5;
const uint ONE = 1u << 24; // a whole surfel, in the fixed point that prefix sums are taken in

// The area that a surfel of t should have whose distance from the eye this is.
float ideal_area(Triangle t, float from_eye) {
    float r = min(per_distance * max(from_eye, nearest), t.more.w);
    return PI * r * r;
}

// No point of the triangle is nearer to the eye than this.
float nearest_to_eye(vec3 a, vec3 b, vec3 c) {
    vec3 middle = (a + b + c) / 3.0, n = cross(b - a, c - a);
    float reach = max(max(distance(a, middle), distance(b, middle)), distance(c, middle));
    float off_plane = abs(dot(n, eye - a)) / max(length(n), 1e-30);
    return max(max(off_plane, distance(middle, eye) - reach), nearest);
}

// How often the sides are halved, so that ideal surfels of one part differ little.
int halvings(Triangle t) {
#ifdef ONE_PASS
    return 0;
#else
    float longest = max(max(distance(t.a.xyz, t.b.xyz), distance(t.b.xyz, t.c.xyz)), distance(t.c.xyz, t.a.xyz));
    float times = longest / nearest_to_eye(t.a.xyz, t.b.xyz, t.c.xyz);
    return clamp(int(ceil(log2(max(times, 1e-6)))), 0, MOST_HALVINGS);
#endif
}

// Shares of the triangle's corners in each corner of its part `m`, after `n` halvings: four parts each time.
mat3 part_of(uint m, int n) {
    mat3 corners = mat3(1.0);
    for (int k = 0; k < n; ++k) {
        vec3 a = corners[0], b = corners[1], c = corners[2];
        uint digit = (m >> (2 * k)) & 3u;
        vec3 ab = 0.5 * (a + b), bc = 0.5 * (b + c), ca = 0.5 * (c + a);
        corners = digit == 0u ? mat3(a, ab, ca) : digit == 1u ? mat3(ab, b, bc)
                : digit == 2u ? mat3(ca, bc, c) : mat3(bc, ca, ab);
    }
    return corners;
}

// Surfels to place on a part; all but a few of every FINE are thinned out again.
uint count_surfels(Triangle t, mat3 corners, float area) {
    mat3 at = mat3(t.a.xyz, t.b.xyz, t.c.xyz) * corners;
#ifdef ONE_PASS
    return max(1u, uint(area / ideal_area(t, distance((at[0] + at[1] + at[2]) / 3.0, eye)) + 0.5));
#else
    return max(1u, uint(ceil(FINE * area / ideal_area(t, nearest_to_eye(at[0], at[1], at[2])))));
#endif
}

// Shares of a part's corners at its point k: the R2 sequence (Roberts 2018), moved by a hash, so that any number
// of points is even; then onto the triangle without a fold (Heitz 2019).
vec3 point_on(uint part, uint k) {
    uvec2 start = hash(uvec3(part, 7u, 11u)).xy;
    vec2 u = vec2(start + k * uvec2(3242174889u, 2447445413u)) * 2.3283064e-10;
    if (u.y > u.x) {
        u.x *= 0.5;
        u.y -= u.x;
    } else {
        u.y *= 0.5;
        u.x -= u.y;
    }
    return vec3(1.0 - u.x - u.y, u);
}
