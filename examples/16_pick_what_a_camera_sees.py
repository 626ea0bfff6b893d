"""Pick what a depth camera sees: `zarm up --robot panda --driver physics --world blocks --perception --map-box=0.2,-0.5,0.015,0.8,0.6,0.6 --map-resolution 0.01`."""

import math

import zarm

DOWN = (1.0, 0.0, 0.0, 0.0)
PIXELS = {"width": 640, "height": 480, "fx": 600.0, "fy": 600.0, "cx": 319.5, "cy": 239.5}
CAMERA = zarm.Camera("front", position=(1.1, -0.25, 0.75), look_at=(0.45, 0.0, 0.0), **PIXELS)

with zarm.connect() as robot:
    robot.scene.clear()
    robot.scene.add(zarm.Cuboid("table", size=(1.0, 1.4, 0.1), position=(0.6, 0.0, -0.055)))
    robot.perception.clear()
    robot.perception.add(CAMERA)
    robot.perception.look(images=10)
    blocks = robot.perception.boxes(floor=0.0)
    print(f"the camera sees {len(blocks)} blocks")
    robot.scene.add(*blocks)
    for n, block in enumerate(blocks):
        x, y, z = block.position
        half = math.atan2(block.orientation[2], block.orientation[3])
        sides = [(math.cos(turn), math.sin(turn), 0.0, 0.0) for turn in (half, half + math.pi / 4)]  # pointing down
        robot.pick(block.name, zarm.AnyOf(*(zarm.Pose((x, y, max(z, 0.02)), side) for side in sides)), mass=0.2)
        robot.place(zarm.Pose((0.38 + 0.14 * (n % 2), 0.26 + 0.14 * (n // 2), z + 0.015), DOWN))
        x, y, _ = robot.scene.objects()[block.name].position
        print(f"{block.name} stands at {x:.2f} {y:.2f}")
    robot.perception.remove("front")
    robot.scene.clear()
