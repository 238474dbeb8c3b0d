// Disks that stand for the surfaces of a scene, in coordinates in which it lies within 1 of the origin.
struct Surfel {
    vec4 place;  // centre, radius
    vec4 facing; // normal, the drawable's number
    vec4 texel;  // atlas coordinate, level of detail that averages over the disk's area, 0
};

struct Triangle {
    vec4 a, b, c; // a.w: the drawable's number; b.w: area; c.w: log4 of the atlas's texels on a unit of area
    vec4 uv;      // atlas coordinates of a and b
    vec4 more;    // of c; the side of the outside: 1, or -1 where it is mirrored; a surfel's largest radius
};

const float PI = 3.14159265;
