// Spheres around parts of what glows: where a pixel may look for light, besides at random.
struct Guide {
    vec4 sphere; // centre, radius
    vec4 facing; // mean normal, which is short where normals differ; area
};
layout(std430, binding = 9) readonly buffer Guides { Guide guides[]; }; // GUIDES

// A receiver nearer to a sphere's middle than this many radii sees it all around, and needs no guide.
const float INSIDE = 1.2;

struct Cone {
    vec3 axis;
    float cosine; // of its half angle
    float hope;   // how much light may come from there, in some unit; 0: none
};

// What a receiver at p with normal n may hope for from guide g, and in which cone: about area, cosines and 1 / distance².
Cone find_cone(int g, vec3 p, vec3 n) {
    vec3 to = guides[g].sphere.xyz - p;
    float d = length(to), r = guides[g].sphere.w;
    Cone cone = Cone(to / max(d, 1e-20), -1.0, 0.0);
    if (d < INSIDE * r) return cone;
    cone.cosine = sqrt(max(1.0 - r * r / (d * d), 0.0));
    float above = clamp((dot(n, to) + r) / d, 0.0, 1.0);
    float spread = 1.0 - length(guides[g].facing.xyz) + r / d;
    float before = clamp(spread - dot(cone.axis, guides[g].facing.xyz), 0.0, 1.0);
    cone.hope = guides[g].facing.w * above * before / (d * d);
    return cone;
}

float solid_angle(Cone cone) {
    return 6.28318531 * max(1.0 - cone.cosine, 1e-7);
}
