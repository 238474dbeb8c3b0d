// The boxes around cells, as render/cell_boxes.py packs them; lengths are in steps of their corners.
layout(rgba32ui, binding = 3) readonly uniform uimage2D boxes;

const float BOX_REACH = 1.0001, BOX_STEP = 2.0 * BOX_REACH / 65535.0;
const float BOX_FARTHEST = 4.0 / BOX_STEP;

struct Box {
    vec3 low, high;
    uint after;  // the cell after its last descendant
    float apart; // how far from its middle the cell may stand for its parts; 0: anywhere
};

vec3 to_boxes(vec3 p) {
    return (p + BOX_REACH) / BOX_STEP;
}

Box box_of(uint cell) {
    uvec4 packed_box = imageLoad(boxes, ivec2(cell & 1023u, cell >> 10u));
    float root = float(packed_box.w >> 24u) / 255.0;
    return Box(vec3(packed_box.xyz & 0xffffu), vec3(packed_box.xyz >> 16u), packed_box.w & 0xffffffu, BOX_FARTHEST * root * root);
}
