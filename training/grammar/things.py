"""Names of objects and places, without an article."""

from training.grammar.template import Templates

# fmt: off
# Lists of words are easier to read with several words to a line.

BOWL: Templates = (
    "black bowl", "black bowl", "black bowl", "bowl", "bowl", "dark bowl", "dark-colored bowl",
    "dark-coloured bowl", "black-colored bowl", "black coloured bowl", "black dish",
    "black round bowl", "round black bowl", "black soup bowl", "black container",
    "bowl that is black", "black ceramic bowl", "small black bowl", "black kitchen bowl",
    "dark dish", "bowl of black color", "dark vessel", "black basin", "ebony bowl", "charcoal bowl",
    "black-hued bowl", "black receptacle", "black serving bowl",
)
PLAIN_BOWL: Templates = (
    "bowl", "bowl", "bowl", "bowl", "black bowl", "dark bowl", "soup bowl", "round bowl",
    "small bowl", "kitchen bowl", "serving bowl", "deep dish", "bowl on the table", "cereal bowl",
    "ceramic bowl", "mixing bowl", "basin", "rounded container", "round container", "food bowl",
)
PLATE: Templates = (
    "plate", "plate", "plate", "plate", "dish", "dinner plate", "serving plate", "platter",
    "flat plate", "round plate", "saucer", "white plate", "flat dish", "plate on the table",
    "dinner dish", "white dish", "serving dish", "tray", "ceramic plate", "dining plate",
    "disc-shaped dish", "flat round dish",
)
RAMEKIN: Templates = (
    "ramekin", "ramekin", "ramekin", "ramekin", "small ramekin", "white ramekin", "ramekin dish",
    "little ramekin", "small white dish", "custard cup", "baking cup", "souffle dish", "small dish",
    "little dish", "small ceramic dish", "small baking dish", "ceramic ramekin", "ramekin bowl",
    "ramekin cup", "small cup", "little cup", "pudding dish", "dessert cup", "tiny dish",
    "small white bowl", "little white bowl", "small ceramic cup", "individual baking dish",
    "small white cup", "small pot",
)
COOKIE_BOX: Templates = (
    "cookie box", "cookie box", "cookie box", "box of cookies", "cookies", "cookies box",
    "biscuit box", "box of biscuits", "cookie package", "cookie carton", "package of cookies",
    "cookie container", "cookie packet", "box with cookies", "cookies package",
    "box with the cookies", "cookie pack", "biscuit package", "snack box", "biscuit carton",
    "carton of cookies", "pack of cookies", "cookie tin", "box containing cookies",
    "packet of biscuits", "pastry box",
)
CABINET: Templates = (
    "cabinet", "cabinet", "wooden cabinet", "wooden cabinet", "cupboard", "wooden cupboard",
    "wood cabinet", "chest of drawers", "drawer unit", "dresser", "storage cabinet", "wooden chest",
    "drawer cabinet", "wooden drawer unit", "wooden chest of drawers", "brown cabinet",
    "cabinet made of wood", "sideboard", "storage unit", "wooden dresser", "bureau",
    "cabinet with drawers", "kitchen cabinet", "locker", "wooden storage unit",
    "wooden piece of furniture", "file cabinet", "commode", "closet", "chest",
)
STOVE: Templates = (
    "stove", "stove", "stove", "stove", "cooker", "hob", "burner", "cooktop", "stovetop",
    "stove top", "hotplate", "hot plate", "range", "kitchen stove", "cooking plate",
    "electric stove", "gas stove", "stove burner", "heating plate", "cooking surface",
    "stove plate", "cooking range", "heater", "kitchen range", "electric burner", "cooking stove",
    "flat stove", "heating element", "cook top",
)
TABLE_CENTER: Templates = (
    "[in|at|from|on] [the|] [center|centre|middle] of the [table|tabletop|table top|desk|surface|"
    "workspace]", "[in|at|from|on] table [center|centre]",
    "[in|at|from] the table's [center|centre|middle]",
    "[in|at|from] the [table|tabletop] [center|centre|middle]", "in the [center|centre|middle]",
    "at the central [spot|position|place|part|point|location|area] [of|on] the table",
    "in the middle area of the table", "from the center", "centered on the table",
    "at the middle point of the table", "in the central area", "midway on the table",
    "from the middle part of the table",
)
BASKET: Templates = (
    "basket", "basket", "basket", "basket", "basket", "wicker basket", "shopping basket",
    "woven basket", "container", "hamper", "bin", "carrier", "picnic basket", "storage basket",
    "brown basket", "crate", "open basket", "grocery basket", "pannier", "big basket",
    "basket on the floor", "basket nearby", "wicker container", "box basket", "receptacle",
    "kitchen basket", "wicker bin",
)
SOUP: Templates = (
    "alphabet soup", "alphabet soup", "alphabet soup", "alphabet soup can", "can of alphabet soup",
    "tin of alphabet soup", "soup", "soup can", "can of soup", "letter soup", "alphabet soup tin",
    "canned alphabet soup", "soup with letters", "canned soup", "alphabet pasta soup",
    "tinned soup", "soup tin", "letter noodle soup", "abc soup", "can with alphabet soup",
    "alphabet noodle soup", "can containing alphabet soup", "tin of soup", "soup container",
    "alphabet broth", "letter pasta can",
)
CREAM_CHEESE: Templates = (
    "cream cheese", "cream cheese", "cream cheese", "cream cheese box", "box of cream cheese",
    "cream cheese package", "package of cream cheese", "pack of cream cheese",
    "packet of cream cheese", "cheese", "cheese box", "soft cheese", "carton of cream cheese",
    "cream cheese block", "block of cream cheese", "cream cheese packet", "cream cheese carton",
    "cheese spread", "cheese package", "cream cheese container", "box with cream cheese",
    "cream cheese pack", "creamy cheese", "spreadable cheese", "tub of cream cheese",
    "dairy spread", "cheese packet", "brick of cream cheese", "box of soft cheese",
)
SALAD_DRESSING: Templates = (
    "salad dressing", "salad dressing", "salad dressing", "dressing", "bottle of salad dressing",
    "salad dressing bottle", "dressing bottle", "bottle of dressing", "dressing for salad",
    "salad sauce", "vinaigrette", "salad vinaigrette", "ranch dressing",
    "bottle with salad dressing", "dressing for the salad", "salad topping",
    "container of salad dressing", "bottled dressing", "salad seasoning", "salad condiment",
    "salad dressing container", "italian dressing", "bottle of vinaigrette",
)
BBQ_SAUCE: Templates = (
    "bbq sauce", "bbq sauce", "bbq sauce", "barbecue sauce", "barbecue sauce", "barbeque sauce",
    "bottle of bbq sauce", "bbq sauce bottle", "bbq bottle", "bottle of barbecue sauce", "bbq",
    "barbecue sauce bottle", "grilling sauce", "b b q sauce", "bar b q sauce", "bbq condiment",
    "barbecue condiment", "bottle with bbq sauce", "smoky sauce", "grill sauce",
    "container of bbq sauce", "bbq marinade", "barbecue bottle", "barbecue dressing",
    "sauce for grilling", "barbecue glaze",
)
KETCHUP: Templates = (
    "ketchup", "ketchup", "ketchup", "ketchup bottle", "bottle of ketchup", "tomato ketchup",
    "catsup", "ketchup container", "squeeze bottle of ketchup", "bottle of tomato ketchup",
    "catsup bottle", "red ketchup bottle", "bottle with ketchup", "red ketchup",
    "ketchup squeeze bottle", "ketchup sauce", "container of ketchup", "ketchup condiment",
    "bottled ketchup", "heinz ketchup", "red condiment bottle", "bottle of catsup",
    "tomato condiment", "red condiment",
)
TOMATO_SAUCE: Templates = (
    "tomato sauce", "tomato sauce", "tomato sauce", "tomato sauce can", "can of tomato sauce",
    "tin of tomato sauce", "tomato sauce tin", "canned tomato sauce", "pasta sauce", "tomato paste",
    "tomato puree", "marinara sauce", "can of tomatoes", "tomato can", "passata",
    "tomato pasta sauce", "jar of tomato sauce", "can with tomato sauce", "red sauce",
    "tomato based sauce", "can containing tomato sauce", "tomato sauce container",
    "sauce made of tomatoes", "tinned tomato sauce", "marinara", "tomato tin",
    "can of tomato puree",
)
BUTTER: Templates = (
    "butter", "butter", "butter", "butter stick", "stick of butter", "box of butter", "butter box",
    "package of butter", "pack of butter", "block of butter", "butter package", "packet of butter",
    "butter packet", "butter block", "piece of butter", "butter container", "butter carton",
    "carton of butter", "butter pack", "slab of butter", "bar of butter", "butter bar",
    "pat of butter", "brick of butter", "wrapped butter", "dairy butter",
)
MILK: Templates = (
    "milk", "milk", "milk", "milk carton", "carton of milk", "milk box", "box of milk",
    "bottle of milk", "milk container", "milk bottle", "container of milk", "milk package",
    "pack of milk", "package of milk", "milk pack", "dairy milk", "carton with milk", "milk packet",
    "white milk carton", "jug of milk", "fresh milk", "cow's milk", "tetra pak of milk",
    "carton containing milk", "dairy drink", "dairy carton",
)
PUDDING: Templates = (
    "chocolate pudding", "chocolate pudding", "chocolate pudding", "pudding", "pudding box",
    "chocolate pudding box", "box of chocolate pudding", "chocolate dessert",
    "chocolate pudding package", "package of chocolate pudding", "pudding cup",
    "chocolate pudding cup", "pudding package", "box of pudding", "chocolate custard",
    "choc pudding", "pack of chocolate pudding", "chocolate mousse", "chocolate pudding mix",
    "packet of chocolate pudding", "pudding mix", "chocolate flavored pudding", "pudding packet",
    "chocolate box", "dessert box", "chocolate pudding container", "cocoa pudding",
    "brown pudding box", "chocolate", "chocolate snack", "dessert",
    "container of chocolate pudding",
)
ORANGE_JUICE: Templates = (
    "orange juice", "orange juice", "orange juice", "orange juice carton", "carton of orange juice",
    "oj", "juice", "juice carton", "orange juice box", "box of orange juice",
    "bottle of orange juice", "orange juice container", "carton of juice", "juice box",
    "orange juice bottle", "container of orange juice", "orange drink", "juice made of oranges",
    "package of orange juice", "orange juice pack", "citrus juice", "fruit juice", "orange carton",
    "pack of orange juice", "orange juice package", "orange beverage", "oj carton", "carton of oj",
)
WINE: Templates = (
    "wine bottle", "wine bottle", "wine bottle", "bottle of wine", "bottle of wine", "wine",
    "bottle", "red wine bottle", "bottle of red wine", "wine bottle on the table", "glass bottle",
    "wine flask", "vino bottle", "dark bottle", "tall bottle", "bottle with wine",
    "bottle containing wine", "full wine bottle", "bottle of vino", "green bottle", "wine vessel",
    "bottled wine",
)
RACK: Templates = (
    "rack", "rack", "rack", "rack", "wine rack", "wine rack", "wine rack", "bottle rack",
    "wine holder", "bottle holder", "wooden rack", "wine stand", "storage rack", "wine bottle rack",
    "rack for bottles", "rack for wine", "wine shelf", "shelf", "wine bottle holder",
    "bottle stand", "wooden wine rack", "rack for wine bottles", "holder", "wine storage rack",
    "bottle shelf",
)
TOP: Templates = (
    "top", "top", "top", "upper", "uppermost", "topmost", "highest", "first", "upper most",
)
MIDDLE: Templates = (
    "middle", "middle", "middle", "center", "centre", "central", "second", "mid", "midmost",
)
BOTTOM: Templates = (
    "bottom", "bottom", "bottom", "lower", "lowest", "bottommost", "lowermost", "third",
    "bottom most", "last",
)
DRAWER: Templates = (
    "drawer", "drawer", "drawer", "drawer", "compartment", "drawer compartment", "tray",
    "sliding drawer", "drawer box", "pull-out drawer", "storage drawer",
)
MOKA: Templates = (
    "moka pot", "moka pot", "moka pot", "coffee pot", "coffee maker", "espresso maker", "moka",
    "mocha pot", "moka coffee pot", "stovetop coffee maker", "percolator", "espresso pot",
    "moka coffee maker", "coffee machine", "coffee brewer", "italian coffee maker",
    "metal coffee pot", "stovetop espresso maker", "coffeepot", "coffee kettle", "kettle",
    "bialetti", "silver coffee pot", "pot", "italian moka pot", "coffee percolator",
    "espresso machine", "mokapot", "metal pot",
)
MOKAS: Templates = (
    "moka pots", "moka pots", "moka pots", "coffee pots", "coffee makers", "espresso makers",
    "mokas", "mocha pots", "moka coffee pots", "stovetop coffee makers", "percolators",
    "espresso pots", "coffee machines", "coffee brewers", "italian coffee makers",
    "metal coffee pots", "coffeepots", "coffee kettles", "kettles", "pots", "silver coffee pots",
    "moka coffee makers", "metal pots", "mokapots", "italian moka pots",
)
WHITE_MUG: Templates = (
    "white mug", "white mug", "white mug", "white cup", "white coffee mug", "white coffee cup",
    "mug that is white", "all-white mug", "plain white mug", "white-colored mug",
    "white drinking cup", "cup that is white", "white tea cup", "white ceramic mug",
    "solid white mug", "entirely white mug", "purely white mug", "mug in white",
    "white coloured cup", "white teacup", "completely white mug", "white tumbler",
)
YELLOW_MUG: Templates = (
    "yellow and white mug", "yellow and white mug", "yellow and white mug", "yellow and white cup",
    "white and yellow mug", "yellow-white mug", "yellow white cup", "white and yellow cup",
    "yellow mug", "yellow cup", "yellow and white coffee mug", "yellow and white coffee cup",
    "two-tone mug", "two-colored yellow and white mug", "mug that is yellow and white",
    "yellow-and-white colored mug", "mug with yellow and white colors", "mug in yellow and white",
    "cup in yellow and white", "yellowish mug", "cup with yellow and white",
    "white mug with yellow", "yellow mug with white", "two-toned yellow and white cup",
    "yellow coffee mug", "bicolor mug", "yellow coffee cup", "yellow and white tea cup",
    "white-yellow mug",
)
LEFT_PLATE: Templates = (
    "left plate", "left plate", "plate on the left", "plate on the left side", "left-hand plate",
    "leftmost plate", "plate to the left", "left dish", "plate at left", "left side plate",
    "dish on the left", "plate at the left side", "left-side plate", "plate that is on the left",
    "plate on the left hand side", "left one of the plates", "plate lying left", "left-most plate",
    "saucer on the left",
)
RIGHT_PLATE: Templates = (
    "right plate", "right plate", "plate on the right", "plate on the right side",
    "right-hand plate", "rightmost plate", "plate to the right", "right dish", "plate at right",
    "right side plate", "dish on the right", "plate at the right side", "right-side plate",
    "plate that is on the right", "plate on the right hand side", "right one of the plates",
    "plate lying right", "right-most plate", "saucer on the right",
)
BOOK: Templates = (
    "book", "book", "book", "book", "black book", "paperback", "novel", "volume", "textbook",
    "book on the table", "book on the desk", "hardcover", "hardcover book", "reading book",
    "publication", "hardback", "tome", "book lying there", "notebook", "workbook", "single book",
    "reading material",
)
CADDY: Templates = (
    "caddy", "caddy", "caddy", "caddy", "desk caddy", "organizer", "organiser", "desk organizer",
    "holder", "desk organiser", "storage caddy", "desk tidy", "book caddy", "table caddy",
    "caddy organizer", "desk holder", "book holder", "stationery holder", "storage box",
    "storage organizer", "caddy box", "divider box", "tidy", "container", "file organizer",
    "desktop organizer", "book stand", "wooden caddy", "office caddy",
)
BACK: Templates = (
    "back", "back", "back", "rear", "rear", "rearmost", "backmost", "hind", "back side",
    "furthest back", "farthest",
)
COMPARTMENT: Templates = (
    "compartment", "compartment", "compartment", "section", "slot", "part", "space", "pocket",
    "partition", "chamber", "division", "area", "bay", "cell", "portion", "side",
)
MICROWAVE: Templates = (
    "microwave", "microwave", "microwave", "microwave", "microwave oven", "microwave oven", "oven",
    "micro oven", "kitchen microwave", "microwave appliance", "white microwave",
    "countertop microwave", "open microwave", "micro wave", "microwave on the table",
    "electric oven", "heating appliance",
)
